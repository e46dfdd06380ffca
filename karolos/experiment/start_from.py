"""Starting from another run's agent: what it has learned, where observations, actions and goals are laid out the same.

Which agent that was is pinned by the sha256 of its state, so that a spec means the same wherever the run lies, and a
checkpoint that was overwritten since is noticed. The sha256 is part of the experiment's identity, the path is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from .. import checkpoint
from ..core import Agent, Signature, State
from ..core.signature import SAME_LAYOUTS, layout_differences
from ..errors import RunError, UsageError
from ..evaluation.policies import signature_of
from ..records import RunFolder
from ..spec import Spec
from ..training.assembly import located

WHERE = "agent.start_from"
SHAPING = ("hidden", "layer_norm", "critic", "dueling", "members")
"""Settings of agents that decide what their weights mean."""


@dataclass(frozen=True)
class Start:
    """What another run's agent had learned."""

    run: str
    checkpoint: str
    sha256: str
    steps: int
    """Environment steps it had been trained for."""
    state: State

    def record(self) -> dict[str, object]:
        """For the run's events."""
        return {"run": self.run, "checkpoint": self.checkpoint, "sha256": self.sha256, "steps": self.steps}


def pinned(spec: Spec, runs: Path) -> Spec:
    """The spec, with the sha256 of the agent that it starts from noted. Raises as `find` does, at the setting."""
    with located(spec):
        start = find(spec, runs)
    if start is None:
        return spec
    settings = spec.agent.settings.model_copy(update={"start_sha256": start.sha256})
    return spec.model_copy(update={"agent": replace(spec.agent, settings=settings)})


def find(spec: Spec, runs: Path) -> Start | None:
    """What the spec's agent starts from; None if from nothing.

    Args:
        spec: of the run that is to begin.
        runs: folder of the runs, for a run that is named by its id.

    Raises:
        UsageError: there is no such run, its agent is of another kind or shape, its environment lays out observations,
            actions or goals in another way, or its checkpoint is not the one that was pinned.
        CheckpointError: the checkpoint is missing or damaged.
    """
    settings = spec.agent.settings
    named = getattr(settings, "start_from", None)
    if named is None:
        return None
    try:
        folder = RunFolder.open(Path(named) if Path(named).is_dir() else runs / named)
    except RunError as error:
        raise UsageError(f"{named!r}: {error.what}", where=WHERE, hint=error.hint) from error
    source = Spec.from_dict(folder.spec())
    _check_agents(spec, source)
    _check_layouts(signature_of(spec), signature_of(source))
    name = settings.start_checkpoint
    parts, meta = checkpoint.load(folder.checkpoints, name)
    sha256 = checkpoint.digest(folder.checkpoints, name, "agent")
    if settings.start_sha256 not in (None, sha256):
        raise UsageError(
            f"checkpoint {name!r} of run {folder.id} is not the one this spec was first run with "
            f"(its agent has sha256 {sha256[:12]}..., not {settings.start_sha256[:12]}...)",
            where=WHERE,
            hint="set agent.start_sha256=null to start from what is there now; that is another experiment",
        )
    return Start(folder.id, name, sha256, int(meta["steps"]), parts["agent"])


def apply(start: Start, agent: Agent) -> None:
    """Let the agent go on from there. Raises UsageError when its networks have another shape."""
    try:
        agent.start_from(start.state)
    except UsageError as error:
        raise UsageError(error.what, where=WHERE, hint=error.hint) from error


def _check_agents(spec: Spec, source: Spec) -> None:
    if spec.agent.name != source.agent.name:
        raise UsageError(
            f"this agent is {spec.agent.name}, that of the run is {source.agent.name}",
            where=WHERE,
            hint=f"set agent.name={source.agent.name}, or name a run of {spec.agent.name}",
        )
    here, there = spec.agent.dump(), source.agent.dump()
    differing = [key for key in SHAPING if here.get(key) != there.get(key)]
    if differing:
        raise UsageError(
            "the run's networks are others: "
            + "; ".join(f"agent.{key} is {here.get(key)} here and {there.get(key)} there" for key in differing),
            where=WHERE,
            hint="set " + " ".join(f"agent.{key}={there.get(key)}" for key in differing),
        )


def _check_layouts(here: Signature, there: Signature) -> None:
    told = layout_differences(here, there)
    if told:
        raise UsageError(
            "the run's agent sees and does other things than this one: " + "; ".join(told),
            where=WHERE,
            hint=SAME_LAYOUTS,
        )
