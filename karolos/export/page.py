"""The page of a bundle: its contract in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from karolos_deploy.readings import OF_JOINTS

from ..environments.robot_task import RobotTask

WORDS = {
    "tool_position": "p of the kinematics below",
    "tool_velocity": "J_v w, w the joint velocities",
    "tool_angular_velocity": "J_w w",
    "tool_rotation": "the first column of R, then its second",
    "tool_heading": "(R[0,0], R[1,0]), divided by its length",
    "gripper_opening": "distance of the pads / the largest; 0 closed, 1 open",
    "joint_positions": "as read",
    "joint_velocities": "as read",
    "joint_effects": "a row of 6 for each joint: its columns of J_v and J_w, times its step below",
    "joint_rooms": "2 for each joint: position - lowest and highest - position, / its step, in [0, {most:g}]",
    "joint_speeds": "for each joint its velocity / (its step * actions per second)",
    "joint_accelerations": "for each joint its acceleration / (its step * actions per second ^ 2), at most 1",
    "set_point": "way from the tool to the set point: s - p, and the rotation vector of S R^T, each no longer than the "
    "largest error of the spring",
    "wrench": "force and torque on the tool at the tool centre point, in the tool's frame, filtered as below",
    "wrench_along_world": "the wrench, both parts turned by R",
    "force_exceeded": "1 once the filtered force was larger than the limit in this episode, else 0",
    "measured": "from cameras or fixtures, in the world's frame",
}
"""Formulas of observations in words."""
TEXT = """# {name}: a policy for the {robot} with the gripper {gripper}

{scope}

Check the files with `sha256sum -c SHA256SUMS`. Run them with karolos-deploy, or by this page alone.
**This policy was never tried on hardware.** Begin without moving: `karolos-deploy . --driver NAME` sends nothing
without `--move`.

| | |
|---|---|
| run | {id}, checkpoint {checkpoint}, {steps:,} steps, karolos {karolos} |
| sha256 of the agent | {sha256} |
| success in simulation | {success} |
| actions per second | {rate:g} |
| largest age of a reading | {late:.0f} ms |
| episode | {episode} actions |
| film | {film} |

## The task
{task}

## Frames and units
Lengths in m, angles in rad, forces in N. The world's z axis points up, and its floor is at z = 0. The robot's base
stands at {base} in the world and is not turned: position in the world = position from the base + this. The tool's
z axis points along its approach.

## Kinematics
Start with p = base, R = 1. For each of the {joints} joints in order: p = p + R t, R = R Q, note the origin o = p and
the axis a = R[:,2], then R = R rotz(q). For the tool: p = p + R t, R = R Q. p is the tool centre point; the columns
of R are the tool's axes. The columns of J_v are a x (p - o), those of J_w are a. t (3 numbers) and Q (9, row by row):

| | t | Q |
|---|---|---|
{links}

## Joints
| joint | lowest | highest | largest speed rad/s | acceleration rad/s2 | torque N m | home | episodes begin at |
|---|---|---|---|---|---|---|---|
{joint_rows}

## Inputs
`observation` (n, {observed}), float32, in this order. Ranges are those of {count} test episodes. The policy
normalises its inputs itself.

| columns | name | unit | least | largest | how it is computed on a robot |
|---|---|---|---|---|---|
{observation}

`desired_goal` (n, {goals}): the goal, in the world's frame.

| columns | name | unit | least | largest |
|---|---|---|---|---|
{desired_goal}

The wrench comes without the weight of gripper and flange: remove the bias with the empty, open gripper at the start
pose (on a UR `zero_ftsensor`), then low-pass it with a time constant of {filter:g} s. A held part counts.

## Output
`action` (n, {actions}), each number in [-1, 1]. The scale is not in the policy: multiply by it.

| columns | name | an action of 1 | least | largest |
|---|---|---|---|---|
{action}

{meaning}

## Limits
The tool stays in the box {low} to {high}. Force at the tool: at most {force:g} N. Speed of the tool: {tool_speed}.
Payload at the flange, gripper and held part together: {payload:.2f} kg.
karolos-deploy stops the robot when one of these is exceeded, when a reading is late, repeated, not finite or jumps, and
when the robot says that it does not move.

## What may be exchanged
Trained {trained} {transfers}

## What was randomized in training
{randomized}

Not randomized: {not_randomized}.

## Check your own port
`golden.npz` has inputs and actions. `episode.npz` has, for each step of an episode, `positions`, `velocities`, `wrench`
(filtered), `opening`, `set_point`, `overloaded` and `measured_...` as read, with the `observation` that follows and the
`action`. Your observation must be the recorded one within 1e-4, and the action, too.
"""


def page(contract: dict[str, Any], environment: RobotTask, *, film: bool) -> str:
    """The page of a bundle, as Markdown. `film`: whether it has a film."""
    run, robot, control, limits = (contract[name] for name in ("run", "robot", "control", "limits"))
    changed = run["changed"]
    document = type(environment.task).__doc__ or ""
    joints = contract["joints"]
    links = contract["kinematics"]["links"]
    names = [*(joint["name"] for joint in joints), "tool"]
    keys = ("lower", "upper", "velocity", "acceleration", "effort", "home")
    starts = [f"{low:.3f} to {high:.3f}" for low, high in zip(*contract["start"], strict=True)]
    columns = {name: sum(one["size"] for one in contract[name]) for name in ("observation", "desired_goal", "action")}
    sections = [part.strip().replace("\n    ", "\n") for part in document.split("\n\n")]
    return TEXT.format(
        **{key: run[key] for key in ("name", "id", "checkpoint", "steps", "karolos", "sha256")},
        robot=robot["name"],
        gripper=robot["gripper"] or ("of its own" if contract["gripper"] else "none"),
        scope=f"It acts {control['rate']:g} times per second in {control['mode']} control.",
        success=_success(run["test"]) if run["test"] else "not tested",
        rate=control["rate"],
        late=1000 * limits["late"],
        episode=contract["episode"]["steps"],
        film="film.mp4" if film else "none: no pictures could be drawn where the bundle was written",
        task="\n\n".join(sections),
        base=_numbers(contract["kinematics"]["base"]),
        joints=len(joints),
        links=_rows([name, _numbers(row[:3]), _numbers(row[3:])] for name, row in zip(names, links, strict=True)),
        joint_rows=_rows(
            [joint["name"], *(f"{joint[key]:.4g}" for key in keys), start]
            for joint, start in zip(joints, starts, strict=True)
        ),
        observed=columns["observation"],
        goals=columns["desired_goal"],
        actions=columns["action"],
        count=20,
        observation=_fields(contract["observation"], _formula),
        desired_goal=_fields(contract["desired_goal"]),
        action=_fields(contract["action"], unit=_moved),
        filter=contract["wrench"]["filter"],
        meaning="\n".join(_meaning(contract)),
        low=_numbers(contract["workspace"][0]),
        high=_numbers(contract["workspace"][1]),
        force=limits["force"],
        tool_speed=f"{limits['tool_speed']:g} m/s" if limits["tool_speed"] else "what the joints allow",
        payload=robot["payload"],
        trained=f"without these changes: {' '.join(changed)}." if changed else "with the arm and gripper above.",
        transfers=_transfers(run["tests_under_changes"]),
        randomized="\n".join(f"* {name}: {_drawn(how)}" for name, how in contract["randomized"].items()) or "Nothing.",
        not_randomized=", ".join(
            f"{name} ({one['nominal']:g} {one['unit']})" for name, one in contract["not_randomized"].items()
        ),
    )


def _rows(rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in values)


def _drawn(how: dict[str, Any]) -> str:
    return " ".join(f"{key} {value}" for key, value in how.items() if value is not None and key != "name")


def _success(row: dict[str, Any]) -> str:
    if row["success_end"] is None:
        return "the task does not define success"
    low, high = row["success_end_interval"]
    return f"{row['success_end']:.3f} in {row['episodes']:,} episodes, 95 % interval {low:.3f} to {high:.3f}"


def _fields(fields: list[dict[str, Any]], formula: Any = None, unit: Any = None) -> str:
    """Rows of a table of fields: columns, name, unit, range, and the formula if there is one."""
    rows, start = [], 0
    for one in fields:
        end = start + one["size"] - 1
        what = unit(one) if unit else one["unit"]
        told = [f"{start}" if end == start else f"{start} to {end}", one["name"], what]
        told += ["<br>".join(f"{value:.4g}" for value in one[key]) for key in ("low", "high")]
        rows.append(told + ([formula(one)] if formula else []))
        start = end + 1
    return _rows(rows)


def _formula(one: dict[str, Any]) -> str:
    if one["formula"] == "difference":
        return " - ".join(one["of"])
    if one["formula"] == "tanh":
        return "tanh of " + ", ".join(
            f"({name}[{column}] + {added:g}) / {scale:g}" for name, column, added, scale in one["of"]
        )
    told = WORDS[one["formula"]].format(**one)
    return told + "; then zeros" if one["formula"] in OF_JOINTS else told


def _moved(one: dict[str, Any]) -> str:
    return f"{_numbers(one['scale'])} {one['unit']}" if "scale" in one else "see below"


def _meaning(contract: dict[str, Any]) -> list[str]:
    """What a robot does with an action."""
    control, spring = contract["control"], contract["control"].get("spring")
    frame = "tool's" if control["frame"] == "tool" and control["mode"] in ("pose", "impedance") else "world's"
    lines = []
    if control["mode"] == "joint":
        lines.append("Each number is a change of a joint within a control step.")
        if any(one["formula"] in OF_JOINTS for one in contract["observation"]):
            steps = _numbers(control["joint_step"])
            lines.append(f"A number of 1 changes its joint by its step: {steps} rad. Further numbers move nothing.")
    elif spring is None:
        lines += [
            f"The action is a change of the tool's pose within a control step, along the {frame} axes, from where it",
            "was read. The target stays in the box below. Damped least squares with the factor",
            f"{contract['kinematics']['damping']:g} m/rad turn it into a change of the joints, which reach its",
            "speed at the end of the step.",
        ]
    else:
        lines += [
            f"The action moves the set point (s, S) of a spring at the tool, along the {frame} axes. It begins at the",
            "tool.",
            f"The spring: {spring['stiffness']:g} N/m, {spring['turn_stiffness']:g} N m/rad, damping ratio",
            f"{spring['damping_ratio']:g}; errors beyond {spring['error_limit']:g} m and",
            f"{spring['turn_error_limit']:g} rad are forgotten, before and after each action.",
        ]
    if control["mode"] == "cartesian":
        lines.append(f"The tool points down; its x axis has the yaw {control['home_yaw']:.6g} rad.")
    gripper = contract["gripper"]
    if gripper and contract["action"][-1]["name"] == "gripper_opening":
        width = f"{gripper['width']:g} m between the pads" if gripper["width"] else "no suction"
        lines.append(f"gripper_opening: -1 closes with {gripper['force']:g} N per finger, 1 opens to {width}.")
    elif gripper:
        lines.append(f"The gripper stays closed around the part, with {gripper['force']:g} N per finger.")
    return lines


def _transfers(tests: list[dict[str, Any]]) -> str:
    if not tests:
        return "It was tested on no other robot: `karolos test RUN robot=NAME` does that."
    return "Tests under changes:\n\n" + _rows([" ".join(one["changed"]), _success(one)] for one in tests)
