"""Report on an arm's file: its errors, the assumptions and doubts of karolos, and broken promises."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..errors import KarolosError, UsageError
from ..registry import load
from ..robots.from_file import FromFile, proposal_of
from ..robots.repair import MJCF, Finding, Repair
from .contracts import candidate, cases, results
from .inspection import picture

Row = dict[str, Any]
"""A statement about a file: its kind (wrong, assumed, doubted, promise), and the text."""


def check_file(
    path: Path, *, repaired: Path | None = None, mass: float | None = None, promises: bool = True, **known: Any
) -> Iterator[Row]:
    """Errors, assumptions and doubts of an arm's file, and the promises that it breaks.

    A file that cannot be used as it is is replaced by its copy `repaired`, if that can be used. `mass` is the arm's by
    its data sheet, in kg; `known` are settings of the robot `urdf`. Raises MachineError if the copy cannot be written,
    and UsageError for an unknown gripper and for a copy that would replace the file or is not named as a URDF.
    """
    if known.get("gripper") is not None:
        load("grippers", known["gripper"])
    if repaired is not None and (repaired.suffix.lower() in MJCF or repaired.absolute() == path.absolute()):
        raise UsageError(f"--repair: the copy cannot be {repaired}", hint="it is a URDF of its own: NAME.urdf")
    repair = Repair(path, mass, expand=repaired is not None)
    for finding in repair.findings:
        yield {"kind": "wrong", **asdict(finding)}
    if repair.robot is None:
        return
    settings: dict[str, Any] = {"file": str(repaired or path), **known}
    if repaired is not None:
        repair.write(repaired)
    elif repair.findings:
        settings |= {"repair": True, "mass": mass}
    try:
        found = proposal_of(FromFile.Settings.model_validate(settings))
    except KarolosError as error:
        yield {"kind": "wrong", **asdict(Finding.of(error, path))}
        return
    for note in (one for one in found.notes if not one.startswith("repaired: ")):
        doubted = note.startswith("doubted: ")
        yield {"kind": "doubted" if doubted else "assumed", "what": note.removeprefix("doubted: ")}
    if found.overload:
        yield {"kind": "wrong", **asdict(Finding(str(path), found.overload))}
        return
    if found.model.tool_step:
        settings["tool_step"] = found.model.tool_step
    promised = cases(candidate("robots", "urdf", **settings), alone=True) if promises else ()
    for case, problem in results(promised):
        kept = {"kept": problem is None, "problem": problem}
        yield {"kind": "promise", "what": case.text, "promise": str(case), **kept}
    yield {"kind": "picture", "picture": picture("urdf", None, (960, 720), **settings)}
