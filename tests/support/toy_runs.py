"""A spec whose run ends within a second."""

from __future__ import annotations

from typing import Any

TOY: dict[str, Any] = {
    "name": "toy",
    "environment": "toy",
    "agent": {"name": "sac", "hidden": [8]},
    "buffer": {"name": "uniform", "capacity": 1000},
    "orchestrator": {"processes": 0, "environments": 2},
    "training": {"steps": 80, "batch_size": 8, "replay_ratio": 4, "warmup_episodes": 2},
    "testing": {"interval": 40, "episodes": 2},
}
