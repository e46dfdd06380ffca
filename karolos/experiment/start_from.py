"""Starts an agent from the learned weights of another run's agent with the same layouts.

The sha256 of the state pins that agent. A spec therefore means the same wherever the run's folder is, and an
overwritten checkpoint is noticed. The sha256 belongs to the experiment's identity, the path does not.
"""

from __future__ import annotations

import os
from pathlib import Path

from ..core import Agent, Deployed
from ..core.signature import SAME_LAYOUTS, layout_differences
from ..errors import RunError, UsageError, closest
from ..evaluation.policies import Learned, playable, read_learned, signature_of, spec_of
from ..records import RunFolder, checkpoint
from ..records.run_folder import renamed
from ..records.shipped import FOLDER, SHIPPED, shipped_names
from ..specification import Spec

SETTING = "agent.start_from"


def pinned(spec: Spec, runs: Path) -> Spec:
    """The spec with the sha256 of the agent that it starts from. Raises as `find` does, at the setting."""
    with spec.located():
        start = find(spec, runs)
    return spec if start is None else spec.having("agent", start_sha256=start.sha256)


def find(spec: Spec, runs: Path) -> Learned | None:
    """The agent that the spec's agent starts from; None without `agent.start_from`.

    A source run may be given by its id in the folder `runs`.

    Raises:
        UsageError: there is no such run, its agent has another kind or shape, its observations, actions or goals have
            another layout, or its checkpoint is not the pinned one.
        CheckpointError: the checkpoint is missing or damaged.
    """
    settings = spec.agent.settings
    run = getattr(settings, "start_from", None)
    if run is None:
        return None
    shipped = FOLDER / run.removeprefix(SHIPPED)
    elsewhere = (folder.path for folder in renamed(runs) if folder.id == run)
    path = next((path for path in (Path(run), runs / run, *elsewhere, shipped) if os.path.isdir(path)), runs / run)
    try:
        folder = RunFolder.open(path)
    except RunError as error:
        like = closest(run, shipped_names())
        ships = f"did you mean {like!r}, a shipped policy? " if like else ""
        raise _refused(f"{run!r}: {error.what}", f"{ships}give a run's full id or its folder") from error
    source = spec_of(folder)
    check_agents(spec, source)
    if differences := layout_differences(signature_of(spec), signature_of(playable(source)), learning=True):
        what = "the run's agent has other observations, actions or goals: "
        raise _refused(what + "; ".join(differences), SAME_LAYOUTS)
    learned = read_learned(folder, settings.start_checkpoint)
    if settings.start_sha256 not in (None, learned.sha256):
        raise _refused(
            f"checkpoint {learned.checkpoint!r} of run {folder.id} is not the one this spec was first run with "
            f"(its agent has sha256 {learned.sha256[:12]}..., not {settings.start_sha256[:12]}...)",
            "set agent.start_sha256=null to start from the present checkpoint, which is another experiment",
        )
    return learned


def apply(start: Learned, agent: Agent) -> None:
    """Load the learned weights into the agent. Raises UsageError if its networks have another shape."""
    try:
        with checkpoint.fitting(f"{start.run}, checkpoint {start.checkpoint}"):
            if isinstance(start.state, Deployed):
                agent.adopt(start.state)
            else:
                agent.start_from(start.state)
    except UsageError as error:
        raise _refused(error.what, error.hint) from error


def check_agents(spec: Spec, source: Spec) -> None:
    """Raise a UsageError if the spec's agent has another kind or shape than that of the source."""
    name = source.agent.name
    if spec.agent.name != name:
        hint = f"set agent.name={name}, or name a run of {spec.agent.name}"
        raise _refused(f"the agent is {spec.agent.name}, and the run's agent is {name}", hint)
    own, theirs = spec.agent.dump(), source.agent.dump()
    differing = [key for key in source.agent.plugin.shaping if own[key] != theirs[key]]
    if differing:
        what = "; ".join(f"agent.{key} is {own[key]} here and {theirs[key]} in the run" for key in differing)
        hint = "set " + " ".join(f"agent.{key}={theirs[key]}" for key in differing)
        raise _refused(f"the run's networks differ: {what}", hint)


def _refused(what: str, hint: str | None) -> UsageError:
    return UsageError(what, setting=SETTING, hint=hint)
