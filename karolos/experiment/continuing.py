"""Continues a finished run for more steps, as a new run that begins at the last checkpoint."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from typing import Any

from ..errors import UsageError
from ..records import RunFolder, checkpoint, provenance
from ..records.shipped import is_shipped
from ..specification import Spec, spec_from_dict
from .checkpointer import BEST
from .events import Listener
from .resume import LAST, check_files, find_run, learner_of
from .writer import RunWriter

CHANGEABLE = ("name", "training.steps", "training.device", "training.threads", "training.diverging")
"""Settings that do not change the results of the earlier steps."""


def continued_spec(source: RunFolder, overrides: Sequence[str]) -> Spec:
    """The spec of the run that goes on from the end of a finished one.

    Raises:
        UsageError: the run is not finished or was shipped without a checkpoint, an override changes more than
            CHANGEABLE, or training.steps is not larger.
        SpecError: an override is not valid.
    """
    start_from = f"agent.start_from={source.path.name if is_shipped(source) else source.id}"
    for override in overrides:
        if override.partition("=")[0].strip() not in CHANGEABLE:
            hint = f"these can change: {', '.join(CHANGEABLE)}; {start_from} begins a new run"
            raise UsageError("this setting cannot change when a run is continued", where=override, hint=hint)
    state = source.state()
    if state.state != "finished":
        hint = f"first `karolos resume {source.id}`, without settings"
        raise UsageError(f"only a finished run can be continued; this one is {state.state}", hint=hint)
    if LAST not in checkpoint.names(source.checkpoints):
        hint = f"{start_from} begins a new run from its policy"
        raise UsageError(f"{source.id} has no checkpoint {LAST!r} to continue from", hint=hint)
    steps = checkpoint.read_meta(source.checkpoints, LAST)["steps"]
    origin = {"experiment": source.description()["experiment"], "at": steps}
    spec = spec_from_dict(source.spec() | {"continued_from": origin}, overrides)
    if spec.training.steps <= steps:
        what = f"the run has taken {steps:,} steps, and training.steps is {spec.training.steps:,}"
        raise UsageError(what, setting="training.steps", hint=f"give a larger number, e.g. training.steps={2 * steps}")
    return spec


def continue_from(source: RunFolder, spec: Spec, listener: Listener) -> RunFolder:
    """The run of `continued_spec`: the existing one, or a new one with everything that the source has.

    Tests, episodes and the checkpoints `best` and `last` are copied; the series in TensorBoard begin here. The source
    stays as it is.

    Raises CheckpointError if a checkpoint is damaged, MachineError if the folder cannot be written. No run is left.
    """
    check_files(spec, source)
    seed, runs = source.description()["seed"], source.path.resolve().parent
    if (found := find_run(runs, spec.name, spec.hash(), seed)) is not None:
        return found
    folder = RunFolder.create(runs, spec.name, seed)
    origin = {"run": source.id, "steps": spec.dump()["continued_from"]["at"]}
    with folder.removed_on_error():
        for name in sorted({BEST, LAST} & {*checkpoint.names(source.checkpoints)}):
            parts, meta = checkpoint.load(source.checkpoints, name)
            checkpoint.save(folder.checkpoints, name, parts, meta | {"experiment": spec.hash()})
        for name in ("tests.jsonl", "episodes.jsonl"):
            if (path := source.path / name).exists():
                shutil.copy(path, folder.path)
        made: dict[str, Any] = {"changed": spec.changed(), "files": spec.files(), "continued_from": origin}
        folder.describe(spec.dump(), experiment=spec.hash(), **made)
    before = source.state()
    folder.set_state("created", steps=before.steps, updates=before.updates, seconds=before.seconds)
    folder.event("continued", **origin, **learner_of(source))
    if other := provenance.other_software(source.description()):
        what = f"{source.id} was made with other software: {'; '.join(other)}"
        RunWriter(folder, None, listener).warn(what, "its continuation may differ from one unbroken run")
    folder.release()
    return folder
