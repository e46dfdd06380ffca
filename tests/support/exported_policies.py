"""Small runs of every agent, whose policies tests export."""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

from karolos.core import FloatArray
from karolos.evaluation.policies import SavedAgent, load_agent
from karolos.export.export import Exported, export_policy
from karolos.launchers.experiment import Experiment
from karolos.records import RunFolder

REPLAY: dict[str, Any] = {
    "environment": "toy",
    "orchestrator": {"processes": 0, "environments": 2},
    "training": {"steps": 120, "batch_size": 16, "replay_ratio": 8, "warmup_episodes": 2},
    "testing": {"interval": 60, "episodes": 2},
}
ROLLOUTS: dict[str, Any] = {
    **REPLAY,
    "buffer": {"name": "on_policy", "rollout": 20},
    "training": {"steps": 120},
}
BITS = {"environment": {"name": "bit_flip", "bits": 4}}
POLE = {"environment": {"name": "gymnasium", "id": "CartPole-v1"}}
CASES: dict[str, dict[str, Any]] = {
    "sac": REPLAY | {"agent": {"name": "sac", "hidden": [16, 8], "fine_goal": 3}},
    "sac_joints": REPLAY
    | {
        "environment": "robot_task",
        "robot": {"name": "ur5", "control": "joint", "joint_slots": 8, "observe": ["rotation"]},
        "task": {"name": "reach_pose", "max_steps": 10},
        "agent": {"name": "sac", "hidden": [8, 16, 16], "per_joint": True, "fine_goal": 3},
        "testing": {"interval": 120, "episodes": 2},
    },
    "td3": REPLAY | {"agent": {"name": "td3", "hidden": [16]}},
    "ddpg": REPLAY | {"agent": {"name": "ddpg", "hidden": [16]}},
    "dqn": REPLAY | BITS | {"agent": {"name": "dqn", "hidden": [16, 8]}},
    "dqn_dueling": REPLAY | BITS | {"agent": {"name": "dqn", "hidden": [16, 8], "dueling": True, "layer_norm": True}},
    "ppo": ROLLOUTS | {"agent": {"name": "ppo", "hidden": [16], "fine_goal": 3}},
    "ppo_discrete": ROLLOUTS | BITS | {"agent": {"name": "ppo", "hidden": [16]}},
    "ppo_goalless": ROLLOUTS | POLE | {"agent": {"name": "ppo", "hidden": [16]}},
}


@cache
def trained(case: str) -> RunFolder:
    """The run of a case, made once for all tests of a process."""
    outcome = Experiment({"name": case, **CASES[case]}).run(Path(mkdtemp(prefix="karolos-export-")))
    return RunFolder.open(outcome.runs[0].folder)


@cache
def exported(case: str) -> Exported:
    """Its export, with ONNX where the package is installed, made once for all tests of a process. Nobody changes it."""
    return export_policy(trained(case), Path(mkdtemp(prefix="karolos-export-")), checkpoint="last")


def asked(folder: RunFolder, count: int = 500) -> tuple[SavedAgent, FloatArray, FloatArray, np.ndarray]:
    """The agent of `last`, random observations and goals of all sizes, and what it does then; indices as (n,)."""
    saved = load_agent(folder, "last")
    generator = np.random.default_rng(7)
    wide = generator.uniform(0.1, 5, (count, 1))

    def inputs(columns: int) -> FloatArray:
        return (wide * generator.normal(size=(count, columns))).astype(np.float32)

    observation, goal = inputs(saved.signature.observation.size), inputs(saved.signature.desired_goal.size)
    return saved, observation, goal, saved.agent.act(observation, goal, explore=False)
