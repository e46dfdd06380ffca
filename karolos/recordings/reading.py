"""Turns a dataset of any format into demonstrations of an environment: maps, checks and judges its columns."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain
from math import isclose, pi
from pathlib import Path
from typing import Any

import numpy as np

from ..core import BoolArray, Discrete, FloatArray, Layout, Signature, Transitions
from ..environments.build import Facts
from ..errors import UsageError
from .lerobot import read_lerobot
from .minari_file import read_minari
from .recording import DESCRIPTION, Columns, Dataset, facts_of, read_own, refuse

UNITS = {
    "mm": ("m", 1e-3),
    "cm": ("m", 1e-2),
    "mm/s": ("m/s", 1e-3),
    "cm/s": ("m/s", 1e-2),
    "deg": ("rad", pi / 180),
    "deg/s": ("rad/s", pi / 180),
    "%": ("1", 1e-2),
}
"""Units that are converted: unit -> SI unit, and factor."""
SI = "SI"
"""Unit of a column that says: all its numbers have the units of the environment."""
LARGEST_ANGLE = 4 * pi
"""Largest plausible value of joints and orientations in rad. Larger values are probably degrees."""
TOLERANCE = 1e-4
"""Largest difference between a recorded reward and the task's rule. Sums of float32 in another order differ by 1e-6."""
EXPRESSION = re.compile(r"(?P<name>[^\s\[]+)(?:\[(?P<first>\d+):(?P<end>\d+)\])?(?: +(?P<unit>\S+))?")
"""NAME, NAME[first:end], either followed by a unit."""


@dataclass(frozen=True)
class Read:
    """The episodes of a dataset in the form of an environment's episodes."""

    episodes: tuple[Transitions, ...]
    successes: int
    """Number of episodes whose goal holds at the last step, by the task's rule."""


def open_source(path: Path) -> Dataset:
    """The dataset in a folder, in any known format. Raises UsageError if the folder is not a dataset."""
    if (path / "meta/info.json").is_file():
        return read_lerobot(path)
    if (path / "data/metadata.json").is_file():
        return read_minari(path)
    if (path / DESCRIPTION).is_file():
        return read_own(path)
    what = "is no recording" if path.is_dir() else "there is no such folder"
    below = (path.glob(f"{'*/' * depth}data/metadata.json") for depth in (1, 2, 3))  # in namespaces of Minari
    if found := next(chain.from_iterable(below), None):
        return refuse(path, "holds recordings, and is none itself", f"write {found.parent.parent.as_posix()}")
    return refuse(
        path, what, "name a LeRobotDataset v3 (meta/), a Minari dataset (data/) or what `karolos dataset` wrote"
    )


def read_recordings(
    path: Path,
    facts: Facts,
    columns: Mapping[str, str],
    count: int,
    on_episode: Callable[[int], object] = lambda _: None,
) -> Read:
    """The first episodes of a dataset, as demonstrations.

    Rewards, success and termination follow from the task's goal rule. A part of the reward that does not depend on the
    goal is read from a dataset of karolos, and is 0 in others. An episode without its last state ends one step
    earlier.

    Args:
        facts: of the environment that is to be learned.
        columns: where a field of observations, `observation`, `achieved_goal`, `desired_goal` or `action` stands in the
            dataset: see EXPRESSION. What is not named has the format's usual name.
        count: episodes; all if there are fewer.
        on_episode: is called before each episode with the number of episodes read so far.

    Raises:
        UsageError: something does not fit; names the file, the episode and the column.
        MachineError: a package is missing.
    """
    source = open_source(path)
    mapping = _Mapping(source, facts, columns)
    mapping.check()
    episodes, successes = [], 0
    for place in range(min(count, len(source.lengths))):
        on_episode(place)
        transitions, success = mapping.transitions(place)
        episodes.append(transitions)
        successes += success
    if not episodes:
        refuse(path, "holds no episode")
    if facts.signature.goal_rule is not None and not successes:
        what = f"none of {len(episodes)} episodes ends with success by the task's rule"
        refuse(path, what, "check units, frames and goals in demonstrations.columns")
    return Read(tuple(episodes), successes)


@dataclass(frozen=True)
class _Mapping:
    """Maps the columns of a dataset to the arrays of an environment."""

    source: Dataset
    facts: Facts
    columns: Mapping[str, str]

    @property
    def signature(self) -> Signature:
        return self.facts.signature

    def check(self) -> None:
        """Raise a UsageError if the dataset's numbers mean something else in the environment, or its rate differs."""
        path, about = self.source.path, self.source.about
        known = {"observation", "achieved_goal", "desired_goal", "action", *self.signature.observation.names}
        if unknown := sorted(set(self.columns) - known):
            what = f"there is no field {unknown[0]!r} here"
            raise UsageError(what, setting=f"demonstrations.columns.{unknown[0]}", hint=f"there are {_list(known)}")
        rate = self.source.rate
        if rate and not isclose(rate, self.facts.rate, rel_tol=1e-3):
            what = f"it has {rate:g} steps a second, and this environment {self.facts.rate:g}"
            refuse(path, what, "record at that rate, or set environment.substeps so that both are the same")
        if about is None or self.columns:
            return
        try:
            there = facts_of(about)
        except (KeyError, TypeError, ValueError) as error:
            refuse(path, f"its description is damaged: {type(error).__name__}: {error}")
        if differences := self.facts.differences(there):
            refuse(path, "it was recorded in another environment: " + "; ".join(differences))

    def part(self, name: str, layout: Layout | Discrete, found: Columns, episode: str) -> FloatArray | None:
        """The array of observation, achieved_goal, desired_goal or action; None if the dataset does not have it."""
        # The format's usual names are used for a dataset of karolos, and for actions.
        whole, usual = self.columns.get(name), self.source.names[name]
        if whole is None and usual in found and (self.source.about or name == "action"):
            whole = f"{usual} {SI}"
        if whole is not None:
            return self._values(name, whole, layout, found, episode)
        if isinstance(layout, Discrete) or name in ("desired_goal", "action"):
            return None
        parts = []
        for one in layout.fields:
            expression = self.columns.get(one.name)
            if expression is None:
                return None
            parts.append(self._values(one.name, expression, Layout((one,)), found, episode))
        rows = min(map(len, parts))
        return np.concatenate([part[:rows] for part in parts], 1)

    def _values(
        self, name: str, expression: str, layout: Layout | Discrete, found: Columns, episode: str
    ) -> FloatArray:
        """The numbers that an expression names, in SI units."""
        setting = f"demonstrations.columns.{name}"
        parsed = EXPRESSION.fullmatch(expression)
        if parsed is None:
            raise UsageError(
                f"{expression!r} is not a column of the recording",
                setting=setting,
                hint="write NAME or NAME[0:3], then a unit",
            )
        column, unit = parsed["name"], parsed["unit"]
        if column not in found:
            refuse(self.source.path, f"{episode} has no column {column!r}", f"it has {_list(found)}")
        values = found[column]
        if parsed["first"]:
            values = values[:, int(parsed["first"]) : int(parsed["end"])]
        if values.shape[1] != layout.size:
            what = f"{episode}, column {column!r} gives {values.shape[1]} numbers for {name}, which has {layout.size}"
            refuse(self.source.path, what, "name a part of it: NAME[0:3]")
        values = np.asarray(values, np.float32)
        if not np.isfinite(values).all():
            row, place = np.argwhere(~np.isfinite(values))[0]
            refuse(self.source.path, f"{episode}, column {column!r} is {values[row, place]} in row {row}")
        if isinstance(layout, Discrete):
            return values
        for one in layout.fields:
            here = values[:, layout.slice(one.name)]
            factor = self._factor(one.unit, unit, setting)
            if factor != 1:
                here *= np.float32(factor)
            if one.unit == "rad" and np.abs(here).max(initial=0) > LARGEST_ANGLE:
                what = f"{episode}, column {column!r}: {one.name} is {np.abs(here).max():.3g} rad"
                refuse(
                    self.source.path, what, f"if these are degrees, say so: demonstrations.columns.{name}: {column} deg"
                )
        return values

    def _factor(self, unit: str, given: str | None, setting: str) -> float:
        if given in (unit, SI) or (given is None and unit == "1"):
            return 1.0
        if given is None:
            raise UsageError(
                f"the unit is missing; the environment uses {unit}", setting=setting, hint="e.g. NAME[0:3] mm"
            )
        known, factor = UNITS.get(given, (None, 1.0))
        if known != unit:
            raise UsageError(f"{given} cannot be converted to {unit}", setting=setting, hint=f"one of {_list(UNITS)}")
        return factor

    def transitions(self, place: int) -> tuple[Transitions, bool]:
        """An episode, and whether it ends with success."""
        path, signature = self.source.path, self.signature
        found, episode = self.source.read(place), f"episode {place}"

        def needed(name: str, layout: Layout | Discrete) -> FloatArray:
            values = self.part(name, layout, found, episode)
            if values is None:
                hint = f"name it: demonstrations.columns.{name}: COLUMN; there are {_list(found)}"
                refuse(path, f"{episode} has no {name} that is known to match the environment", hint)
            return values

        observation = needed("observation", signature.observation)
        action = needed("action", signature.action)
        desired = needed("desired_goal", signature.desired_goal) if signature.desired_goal.size else observation[:, :0]
        achieved = self.part("achieved_goal", signature.achieved_goal, found, episode)
        if achieved is None:
            achieved = self._observed(observation)
        if achieved is None:
            achieved = needed("achieved_goal", signature.achieved_goal)
        steps = min(len(action), len(observation) - 1, len(achieved) - 1)
        if steps < 1 or len(desired) < steps:
            refuse(path, f"{episode} has {len(action)} actions and {len(observation)} states: too few to learn from")
        if isinstance(signature.action, Discrete):
            allowed = np.isin(action, np.arange(len(signature.action.labels)))
        else:
            allowed = np.abs(action) <= 1 + 1e-6
        if not allowed.all():
            row, column = np.argwhere(~allowed)[0]
            what = f"{episode}, row {row}: action[{column}] is {action[row, column]:.3g}"
            refuse(path, what, "actions here are shares of the largest movement, in [-1, 1], or indices of a set")
        following, goal = achieved[1 : steps + 1], desired[:steps]
        reward, terminated, success = self._judged(found, episode, following, goal)
        early = int(np.argmax(terminated)) + 1 if terminated.any() else steps
        truncated = np.zeros(steps, np.bool_)
        truncated[early - 1] = not terminated[early - 1]
        transitions = Transitions(
            environment=np.zeros(steps, np.int64),
            observation=observation[:steps],
            achieved_goal=achieved[:steps],
            desired_goal=goal,
            action=action[:steps],
            reward=np.asarray(reward, np.float32),
            next_observation=observation[1 : steps + 1],
            next_achieved_goal=following,
            terminated=terminated,
            truncated=truncated,
        )
        cut: Any = (array[:early] for array in transitions)
        return Transitions(*cut), success

    def _judged(
        self, found: Columns, episode: str, following: FloatArray, goal: FloatArray
    ) -> tuple[FloatArray, BoolArray, bool]:
        """Rewards and terminations of steps that arrive at `following`, and whether the last one is a success."""
        source, signature = self.source, self.signature
        rule, steps = signature.goal_rule, len(following)
        recorded, ended = found.get(source.names["reward"]), found.get(source.names["terminated"])
        if rule is None:
            if recorded is None:
                refuse(source.path, f"{episode} has no rewards, and the environment has no goals to compute them from")
            over = np.zeros(steps, np.bool_) if ended is None else ended[:steps, 0].astype(np.bool_)
            return np.asarray(recorded[:steps, 0], np.float32), over, False
        reward = np.asarray(rule.reward(following, goal), np.float32)
        low, high = signature.extra_reward
        if source.about is not None and recorded is not None:
            own = np.asarray(recorded[:steps, 0], np.float32)
            fits = (own >= reward + low - TOLERANCE) & (own <= reward + high + TOLERANCE)  # nan is not
            if not fits.all():
                row = int(np.argmin(fits))
                what = f"{episode}, row {row}: the reward is {own[row]:.4g}, by the task's rule {reward[row]:.4g}"
                refuse(source.path, what, "it is of another task, or damaged")
            reward = own
        terminated = np.asarray(rule.terminated(following, goal), np.bool_)
        return reward, terminated, bool(rule.success(following[-1], goal[-1]))

    def _observed(self, observation: FloatArray) -> FloatArray | None:
        """The achieved goal, taken from the observations if they have all its fields by the same names."""
        layout = self.signature.observation
        sizes = {one.name: one.size for one in layout.fields}
        fields = self.signature.achieved_goal.fields
        if any(sizes.get(one.name) != one.size for one in fields):
            return None
        return np.concatenate([observation[:, layout.slice(one.name)] for one in fields] or [observation[:, :0]], 1)


def _list(names: Any) -> str:
    text = ", ".join(sorted(map(str, names)))
    return text if text.isprintable() else ascii(text)
