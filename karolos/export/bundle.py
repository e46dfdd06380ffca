"""`karolos export --bundle`: a folder that karolos-deploy runs on a robot's computer, with its own documentation.

policy.onnx, policy.npz  the policy, see `export`
policy.yaml              LEAPP's description of it (config 1.3); karolos' own contract stands under `karolos`
golden.npz               inputs and actions to check a port against
episode.npz              an episode in training's world: readings, observations and actions
film.mp4                 the same episode
spec.json, run.json      the resolved spec and the run's record
README.md                everything in words
SHA256SUMS               of every file
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from karolos_deploy.bundle import FORMAT, JOINTS_FORMAT, Bundle, write_sums, write_yaml
from karolos_deploy.readings import OF_JOINTS

from ..core import Layout
from ..environments.build import used
from ..environments.robot_task import RobotTask
from ..errors import MachineError, UsageError
from ..evaluation.changed_spec import changed_spec
from ..evaluation.playing import play
from ..evaluation.policies import Policy, SavedAgent, environment_of, load_agent, playable
from ..records import RunFolder, provenance
from ..report.video import write_film
from ..robots.arm import Arm
from ..robots.control import MOST_ROOM, POSTURE_GAIN
from ..robots.protective_stop import ProtectiveStop
from ..simulation.geometry import matrix_of
from ..simulation.interface import Task
from ..specification import Spec
from ..system.files import write_json, writing
from .export import Exported, export_policy
from .page import page

EPISODES = 20
"""Test episodes that are played for the ranges of inputs and outputs."""
FILES = {"policy.onnx", "policy.npz", "policy.json", "golden.npz"}
ROBOT = {
    "tool_position": "tool_position", "tool_velocity": "tool_velocity", "tool_rotation": "tool_rotation",
    "tool_angular_velocity": "tool_angular_velocity", "tool_heading": "tool_heading", "wrench": "wrench",
    "gripper_opening": "gripper_opening", "joint_positions": "joint_positions", "set_point": "set_point",
    "joint_velocities": "joint_velocities", "peg_wrench": "wrench_along_world", "overloaded": "force_exceeded",
} | dict(zip(OF_JOINTS, OF_JOINTS, strict=True))  # fmt: skip
"""Fields of observations -> the formula by which karolos-deploy computes them from joints and wrist."""


_UNREAL = {"robot.latency", "robot.jitter", "robot.observation_noise"}
"""Parameters by which an observation is not that of a reading."""


def export_bundle(folder: RunFolder, out: Path, changes: Sequence[str] = (), *, checkpoint: str = "best") -> Exported:
    """Write the bundle of a run's policy.

    Args:
        out: folder to write to; it must be empty, or hold an older bundle.
        changes: overrides as of `changed_spec`, such as robot.name=ur5: the bundle is for this robot and task.
        checkpoint: `best` or `last`.

    Raises:
        UsageError: the policy moves no arm, or has actions that cannot be sent to a robot, or layouts are changed, or
            observations.
        SpecError: a change is not valid.
        RunError, MachineError: as `export_policy`.
    """
    saved = load_agent(folder, checkpoint)
    spec = changed_spec(saved.spec, changes, trained=saved.signature) if changes else playable(saved.spec)
    if unreal := sorted(_UNREAL & spec.dump().get("randomization", {}).keys() if changes else ()):
        hint = "leave it out: its logged episode must give the same observations again, and a robot has its own"
        raise UsageError(f"a bundle cannot have {unreal[0]}", where="override", hint=hint)
    with used(environment_of(spec, randomize=bool(changes))) as environment:
        if not isinstance(environment, RobotTask) or not isinstance(environment.robot, Arm):
            hint = "leave out --bundle"
            raise UsageError("a bundle is for a policy that moves an arm", where=folder.id, hint=hint)
        settings = arm_of(environment).settings
        for name, found in (
            ("discrete actions", environment.settings.actions == "discrete"),
            ("actions that choose a stiffness", settings.stiffness_range is not None),
            ("a release within a control step (robot.timed_release)", settings.timed_release),
        ):
            if found:
                raise UsageError(f"a bundle cannot have {name}", where=folder.id, hint="leave out --bundle")
        _make_room(out)
        done = export_policy(folder, out, checkpoint=checkpoint, onnx=True)
        contract = describe(folder, saved, environment, spec if changes else saved.spec, changes)
        logged, seen = record(environment, saved.policy(), contract, saved.spec.testing.seed)
        fields = {"observation": contract["observation"], "desired_goal": contract["desired_goal"]}
        for name, rows in {**fields, "action": contract["action"]}.items():
            _add_ranges(rows, seen[name])
        contract["start"] = [seen["start"].min(0).tolist(), seen["start"].max(0).tolist()]
        with writing(out):
            np.savez(out / "episode.npz", **logged)
            with suppress(MachineError):  # this machine cannot draw pictures; the page says that there is no film
                moments = play(environment, saved.policy(), episodes=1, seed=saved.spec.testing.seed)
                write_film(out / "film.mp4", moments, environment, (640, 480))
            (out / "policy.json").unlink()
            write_json(out / "spec.json", (spec if changes else saved.spec).dump())
            write_json(out / "run.json", folder.description())
            write_yaml(out / "policy.yaml", leapp(out, contract))
            (out / "README.md").write_text(
                page(contract, environment, film=(out / "film.mp4").is_file()), encoding="utf-8"
            )
            write_sums(out)
    Bundle(out).replay_episode()
    return Exported(out, tuple(sorted(out.iterdir())), done.checkpoint, done.steps, done.error)


def _make_room(out: Path) -> None:
    """Remove an older bundle. Raises UsageError for a folder with other files."""
    found = {path.name for path in out.iterdir()} if out.is_dir() else set()
    ours = FILES | {"policy.yaml", "episode.npz", "film.mp4", "spec.json", "run.json", "README.md", "SHA256SUMS"}
    if strange := sorted(found - ours if "policy.npz" in found else found):
        raise UsageError(
            f"{out} holds {strange[0]}, which does not belong to a bundle", hint="name an empty folder: --out"
        )
    for name in found:
        (out / name).unlink()


def describe(
    folder: RunFolder, saved: SavedAgent, environment: RobotTask, played: Spec, changes: Sequence[str]
) -> dict[str, Any]:
    """The contract: everything that is needed to run the policy. JSON-able, SI units, in the world's frame."""
    task, signature, spec = environment.task, saved.signature, played.dump()
    changed = [one for one in folder.transfers().rows if one.sha256 == saved.sha256]
    wanted = tuple(changes), False
    here = [one for one in changed if (one.overrides, one.randomized) == wanted] if changes else [saved.tested]
    tested = here[-1].row() if here and here[-1] is not None else None
    drawn = saved.spec.dump().get("randomization", {})
    observed = _observed(signature.observation.acting, task)
    return {
        "format": JOINTS_FORMAT if any(one["formula"] in OF_JOINTS for one in observed) else FORMAT,
        "run": {
            "id": folder.id,
            "experiment": folder.description()["experiment"],
            "name": saved.spec.name,
            "checkpoint": saved.checkpoint,
            "sha256": saved.sha256,
            "steps": saved.steps,
            "karolos": provenance.versions()["karolos"],
            "changed": list(changes),
            "test": {key: tested[key] for key in _SUCCESS} if tested else None,
            "tests_under_changes": [
                {"changed": list(one.overrides), **{key: one.row()[key] for key in _SUCCESS}} for one in changed
            ],
        },
        **describe_robot(environment, spec["robot"]["name"]),
        "observation": observed,
        "desired_goal": signature.desired_goal.described(),
        "episode": {"steps": task.max_steps, "task": spec["task"]},
        "randomized": drawn,
        "not_randomized": {
            name: {"nominal": parameter.nominal, "unit": parameter.unit, "what": parameter.description}
            for name, parameter in environment.declared.items()
            if name not in drawn
        },
    }


def describe_robot(environment: RobotTask, name: str) -> dict[str, Any]:
    """The part of the contract that arm, gripper and control mode define."""
    arm, task = arm_of(environment), environment.task
    settings, facts = arm.settings, arm.facts()
    gripper = settings.gripper or arm.model.gripper
    stop = settings.protective_stop
    stop = stop if isinstance(stop, ProtectiveStop) else ProtectiveStop.model_validate({})
    force = min(stop.force or inf, getattr(task.settings, "force_limit", inf))
    turns, control = arm.orientations, {key: getattr(settings, key) for key in _STEPS}
    control |= {
        "mode": facts["control"],
        "rate": facts["rate"],
        "moved": facts["moved"],
        "joint_step": list(arm.joint_step),
        "home_yaw": arm.home_yaw,
        "posture_gain": POSTURE_GAIN,
        "steps_down": arm.model.steps_down,
        "orientations": {"middle": matrix_of(turns.middle).tolist(), "tilt": turns.tilt, "turn": turns.turn},
        "spring": facts.get("spring"),
    }
    payload = arm.model.gripper_mass + task.held_mass
    return {
        "robot": {"name": name, "gripper": gripper, "payload": payload},
        "kinematics": {"base": list(arm.base), "links": arm.chain.links.tolist(), "damping": arm.chain.damping},
        "joints": facts["joints"],
        "control": control,
        "workspace": [list(arm.workspace.low), list(arm.workspace.high)],
        "limits": {"force": force, "tool_speed": facts.get("tool_speed"), "late": 1 / facts["rate"]},
        "wrench": {"filter": settings.wrench_filter},
        "gripper": _gripper(arm) if facts.get("gripper") or task.uses_gripper == "closed" else None,
        "action": facts["action"],
    }


_STEPS = ("tool_step", "turn_step", "yaw", "yaw_step", "frame")
_SUCCESS = ("episodes", "success_end", "success_end_interval")


def _gripper(arm: Arm) -> dict[str, Any]:
    found = arm.gripper
    width, force = getattr(found, "width", None), getattr(found, "force", getattr(found, "max_force", None))
    return {"closed": -1, "open": 1, "width": width, "force": force, "speed": getattr(found, "speed", None)}


def _observed(layout: Layout, task: Task) -> list[dict[str, Any]]:
    """The fields of the observation, each with the formula by which it is computed on a robot."""
    fields = layout.described()
    for field in fields:
        name = field["name"]
        stem = name.removesuffix("_from_tool")
        if name in ROBOT:
            field["formula"] = ROBOT[name]
            if name == "joint_rooms":
                field["most"] = MOST_ROOM
        elif stem != name and f"{stem}_position" in layout.names:
            field |= {"formula": "difference", "of": [f"{stem}_position", "tool_position"]}
        elif name in task.fine_fields:
            field |= {"formula": "tanh", "of": [list(one) for one in task.fine_fields[name]]}
        else:
            field["formula"] = "measured"
    return fields


def record(
    environment: RobotTask, policy: Policy, contract: dict[str, Any], seed: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Play `EPISODES` test episodes. Returns the columns of the first one, and all inputs and outputs."""
    arm, task = arm_of(environment), environment.task
    full, size = arm.observation + task.observation, environment.signature.observation.acting.size
    measured = [one["name"] for one in contract["observation"] if one["formula"] == "measured"]
    rows: list[dict[str, Any]] = []
    seen: dict[str, list[Any]] = {"observation": [], "desired_goal": [], "action": [], "start": []}
    episode = 0

    def act(step: Any) -> Any:
        action = policy.act(step)
        acted = {"observation": step.observation[:size], "desired_goal": step.desired_goal, "action": action}
        for name, value in acted.items():
            seen[name].append(value)
        if not episode:
            numbers = np.array([*arm.observe(), *task.observe()])  # without noise
            values = {name: numbers[full.slice(name)] for name in full.names}
            rows.append(
                {
                    "time": len(rows) * arm.period,
                    "positions": arm.joint_positions,
                    "velocities": arm.joint_velocities,
                    "wrench": arm.wrench,
                    "opening": arm.opening,
                    "overloaded": values.get("overloaded", [0.0])[0],
                    "set_point": values.get("set_point", np.zeros(6)),
                    **{f"measured_{name}": values[name] for name in measured},
                    **acted,
                }
            )
        return action

    for moment in play(environment, Policy(act, policy.begin), episodes=EPISODES, seed=seed):
        if moment.step == 0:
            seen["start"].append(arm.joint_positions)
        episode = moment.episode + moment.over
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}, {n: np.array(v) for n, v in seen.items()}


def arm_of(environment: RobotTask) -> Arm:
    """The environment's robot, an arm."""
    arm: object = environment.robot
    assert isinstance(arm, Arm)
    return arm


def _add_ranges(fields: list[dict[str, Any]], seen: Any) -> None:
    """Add the least and largest value of each column in `EPISODES` test episodes."""
    start = 0
    for field in fields:
        columns = seen[:, start : start + field["size"]].astype(float)
        field["low"], field["high"] = columns.min(0).round(6).tolist(), columns.max(0).round(6).tolist()
        start += field["size"]


def leapp(out: Path, contract: dict[str, Any]) -> dict[str, Any]:
    """Content of policy.yaml: LEAPP's keys, which describe the ONNX model, and ours under `karolos`."""

    def tensor(name: str, fields: list[dict[str, Any]], kind: str) -> dict[str, Any]:
        columns = [f"{one['name']}[{inside}]" for one in fields for inside in range(one["size"])]
        shape = [1, len(columns)]
        told = {"name": name, "dtype": "float32", "shape": shape, "type": "tensor", "kind": kind}
        return {**told, "element_names": [None, columns], "frame": "world"}

    names = [name for name in ("observation", "desired_goal") if contract[name]]
    digest = hashlib.sha256((out / "policy.onnx").read_bytes()).hexdigest()
    pose = "pose_rel" if contract["control"]["mode"] != "joint" else "joint_position_rel"
    action = tensor("action", contract["action"], f"target/{pose}") | {
        "isaaclab_connection": f"action:arm_action:{pose}"
    }
    kinds = {"observation": "state/observation", "desired_goal": "command/desired_goal"}
    policy = {
        "inputs": [tensor(name, contract[name], kinds[name]) for name in names],
        "outputs": [action],
        "parameters": {"backend": "onnx", "model_path": "policy.onnx", "sha256sum": digest},
    }
    flow: dict[str, Any] = {"data_flow": {}, "feedback_flow": {}}
    pipeline = {**flow, "inputs": {"policy": names}, "outputs": {"policy": ["action"]}}
    pipeline["configs"] = {"frequency": contract["control"]["rate"]}
    system = {"leapp version": f"karolos {provenance.versions()['karolos']}", "leapp config version": "1.3"}
    return {"models": {"policy": policy}, "pipeline": pipeline, "system information": system, "karolos": contract}
