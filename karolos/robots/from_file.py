"""An arm from a file, without a package: `robot: {name: urdf, file: arm.urdf, gripper: robotiq_2f85}`."""

from __future__ import annotations

import hashlib
import json
import re
from contextlib import suppress
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from pydantic import Field as Setting
from pydantic import TypeAdapter, ValidationError

from ..core.settings import LATER
from ..errors import MachineError, PluginError, UsageError
from ..registry import load
from ..simulation.geometry import Box, Vector
from ..system.files import fingerprint, install_hint, user_cache, write_whole, writing
from .arm import Arm
from .model import ArmModel
from .proposal import Known, Proposal, propose
from .repair import MJCF, Repair
from .settings import ArmSettings

CHECK = "`karolos robot check` shows everything at once; robot.repair=true repairs what it can"
_PROPOSAL = TypeAdapter(Proposal)


class FromFile(Arm):
    """An arm from a URDF. Missing facts are assumed; `karolos robot check FILE` lists the assumptions.

    The content of the file and its meshes belongs to the experiment. A gripper replaces the hand in the file. The
    assumptions are computed once, and kept in the user's cache folder.
    """

    class Settings(ArmSettings):
        """The settings of every arm, and settings that replace an assumption."""

        file: str = Setting(
            description="a URDF or MJCF file: a path relative to the spec (in overrides: to the current folder), or "
            "installed:PACKAGE/PATH"
        )
        mass: float | None = Setting(
            None, gt=0, description="mass of the arm, kg; the file's masses are scaled to it; null: as the file says"
        )
        repair: bool = Setting(
            False,
            json_schema_extra=LATER,
            description="repair the file as `karolos robot check --repair` does, except for xacro",
        )
        tool: str | None = Setting(None, description="link of the tool frame, z forwards; null: by usual names")
        flange: str | None = Setting(
            None, description="link that carries a gripper, z away from the arm; null: searched"
        )
        flange_yaw: float | None = Setting(
            None, ge=-7, le=7, description="turn of a gripper about the flange's z, rad; null: its fingers close across"
        )
        home: tuple[float, ...] | None = Setting(
            None, description="joint positions in which the tool points down, rad; null: by inverse kinematics"
        )
        workspace: tuple[Vector, Vector] | None = Setting(
            None,
            description="lower and upper corner of the tool's reach while it points down, m; null: computed",
        )
        payload: float | None = Setting(None, gt=0, description="largest load of the flange with the gripper, kg")

    settings: Settings

    @classmethod
    def bare_model(cls, settings: ArmSettings) -> ArmModel:
        assert isinstance(settings, cls.Settings)
        try:
            found = proposal_of(settings)
            if found.overload:
                hint = "compare the data sheet, or mount a lighter gripper"
                raise PluginError(found.overload, where=settings.file, hint=hint)
        except (PluginError, UsageError) as error:  # otherwise the task would be blamed
            what = ": ".join(filter(None, (error.where, error.what)))
            raise type(error)(what, setting=error.setting or "robot.file", hint=error.hint) from None
        return found.model


def proposal_of(settings: FromFile.Settings) -> Proposal:
    """The arm proposed for a file, from the user's cache folder if it was computed before. Raises as `propose`."""
    known = Known(
        tool=settings.tool,
        flange=settings.flange,
        flange_yaw=settings.flange_yaw,
        home=settings.home,
        workspace=settings.workspace and Box(*settings.workspace),
        payload=settings.payload,
    )
    path = Path(settings.file)
    content = fingerprint(path)
    if content is None:
        hint = "name a URDF or an MJCF file; in a spec relative to it, in an override to the current folder"
        what = f"there is no file {settings.file}"
        raise UsageError(what, setting="robot.file", hint=install_hint(settings.file) or hint)
    plain = path.suffix.lower() not in MJCF and settings.mass is None and not settings.repair
    mounted = str(load("grippers", settings.gripper).model) if settings.gripper else ""
    parts = [content, settings.gripper, mounted, asdict(known), _source(), plain or str(path.parent)]
    parts += [] if plain else [str(settings.mass), str(settings.repair)]
    key = hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]
    made = None if plain else _Made(settings.mass, settings.repair)
    found = _cached(path, key, settings.gripper, known, made)
    return replace(found, model=replace(found.model, urdf=path)) if plain else found


class _Made(NamedTuple):
    """How a URDF is made of a file."""

    mass: float | None
    """Of the whole arm in kg."""
    repair: bool
    """Whether to repair limits, too, and to leave out what cannot be read."""


@lru_cache(maxsize=64)
def _cached(path: Path, key: str, gripper: str | None, known: Known, made: _Made | None) -> Proposal:
    """`propose`, from the user's cache folder if these contents were proposed for before."""
    place = None
    with suppress(RuntimeError, OSError, ValidationError):  # no home, or a damaged file: compute it again
        place = user_cache() / "robots" / f"{key}.json"
        found = _PROPOSAL.validate_json(place.read_bytes())
        if made is None or found.model.urdf.is_file():
            return found
    used, notes = _as_urdf(path, made, place)
    try:
        found = propose(used, gripper, known)
    except (PluginError, UsageError) as error:  # the user knows the file, not the copy
        lines = r"(:\d+)?" if used != path else ""  # those of the copy
        where = error.where and re.sub(re.escape(str(used)) + lines, lambda _: str(path), error.where)
        hint = CHECK if made and not made.repair and "<limit>" in str(error.hint) else error.hint  # MJCF has none
        raise type(error)(error.what, where=where, setting=error.setting, hint=hint) from None
    found = replace(found, notes=(*notes, *found.notes))
    if place is not None:
        with suppress(OSError, MachineError):  # a folder that cannot be written
            place.parent.mkdir(parents=True, exist_ok=True)
            write_whole(place, _PROPOSAL.dump_json(found).decode(), durable=False)
    return found


def _as_urdf(path: Path, made: _Made | None, beside: Path | None) -> tuple[Path, list[str]]:
    """The file, or a URDF that is made of it in the cache folder, and notes on what is made."""
    if made is None:
        return path, []
    if beside is None:
        raise MachineError("there is no folder for caches", where=str(path), hint="set XDG_CACHE_HOME")
    repair, copy = Repair(path, made.mass, limits=made.repair), beside.with_suffix(".urdf")
    for one in repair.findings:
        if not one.change and not (made.repair and repair.robot is not None):
            raise PluginError(one.what, where=one.where, hint=CHECK)
    with writing(copy):
        copy.parent.mkdir(parents=True, exist_ok=True)
    repair.write(copy)
    return copy, [f"repaired: {one.what}{one.change and f': {one.change}'}" for one in repair.findings]


@lru_cache(maxsize=1)
def _source() -> list[str | None]:
    """The code on which proposals depend, in addition to the file."""
    here = Path(__file__).parent
    files = (
        "repair.py",
        "../simulation/fixtures.py",
        "../simulation/mujoco/mjcf.py",
        "proposal.py",
        "poses.py",
        "loads.py",
        "mounting.py",
        "../simulation/urdf.py",
    )
    return [fingerprint(here / name, follow=False) for name in files]
