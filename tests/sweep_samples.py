"""What the tests of sweeps share: a point on a line, learned within a second where the learning rate is right."""

from __future__ import annotations

from typing import Any


def sweep_spec(space: dict[str, Any], **sweep: Any) -> dict[str, Any]:
    return {
        "name": "line",
        "environment": {"name": "toy", "dimensions": 1, "threshold": 0.2, "speed": 0.3, "max_steps": 10},
        "agent": {"name": "sac", "hidden": [32], "learning_rate": 1e-6, "discount": 0.9},
        "buffer": {"capacity": 2000, "hindsight": {"strategy": "future"}},
        "orchestrator": {"processes": 0, "environments": 4},
        "training": {"steps": 200, "batch_size": 32, "replay_ratio": 32, "warmup_episodes": 4},
        "testing": {"interval": 50, "episodes": 10},
        "sweep": {"space": space, "seeds": [0], **sweep},
    }


LEARNING_RATE = {"agent.learning_rate": {"float": [1e-6, 1e-1], "log": True}}
