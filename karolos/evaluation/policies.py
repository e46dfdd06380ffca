"""Agents as runs have saved them, put together again to act."""

from __future__ import annotations

from dataclasses import dataclass

from .. import checkpoint
from ..core import Agent, Signature
from ..core.seeding import SeedTree
from ..environments.build import build_environment
from ..errors import RunError
from ..records import RunFolder
from ..registry import load
from ..spec import Spec


@dataclass(frozen=True)
class SavedAgent:
    """The agent of a checkpoint, on the CPU."""

    spec: Spec
    """What the run was made from."""
    signature: Signature
    """Of the environment that the agent was trained in."""
    agent: Agent
    checkpoint: str
    sha256: str
    """Of the agent's state in the checkpoint, as hexadecimal digits."""
    steps: int
    """Environment steps it had been trained for."""
    seconds: float
    """Wall-clock seconds of collecting and learning until then."""


def load_agent(folder: RunFolder, name: str = "best") -> SavedAgent:
    """The agent of a run's checkpoint.

    Args:
        folder: the run's.
        name: `best` or `last`.

    Raises:
        RunError: the run has no such checkpoint, or it or its resolved spec is damaged.
    """
    resolved = folder.spec()
    if not resolved:
        raise RunError("resolved.json is missing or damaged", where=folder.id, hint="restore the folder from a copy")
    spec = Spec.from_dict(resolved)
    parts, meta = checkpoint.load(folder.checkpoints, name, only={"agent"})
    signature = signature_of(spec)
    agent: Agent = load("agents", spec.agent.name)(spec.agent.settings, signature, SeedTree(0), "cpu")
    agent.load_state(parts["agent"])
    sha256 = checkpoint.digest(folder.checkpoints, name, "agent")
    return SavedAgent(spec, signature, agent, name, sha256, int(meta["steps"]), float(meta["seconds"]))


def signature_of(spec: Spec, *, randomize: bool = False) -> Signature:
    """What an agent may know of this spec's environment; no world of a robot is simulated."""
    environment = build_environment(spec.recipe(randomize=randomize))
    try:
        return environment.signature
    finally:
        environment.close()
