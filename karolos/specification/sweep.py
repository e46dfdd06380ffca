"""The `sweep` of a spec (search space, sampler, objectives), and its `transfer` between settings."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import (
    AfterValidator,
    BeforeValidator,
    SerializerFunctionWrapHandler,
    StringConstraints,
    model_serializer,
    model_validator,
)
from pydantic import Field as Setting

from ..core import Measure, Settings
from ..errors import Problem, UsageError, alternatives
from .tree import RANDOMIZATION, Node, segments

Seed = Annotated[int, Setting(ge=0, le=2**63 - 1)]
"""A seed of at most 63 bits, which every database stores as a number."""


def _distinct(seeds: tuple[int, ...]) -> tuple[int, ...]:
    if not seeds:
        raise ValueError("should contain at least one seed")
    twice = [seed for place, seed in enumerate(seeds) if seed in seeds[:place]]
    if twice:
        raise ValueError(f"contains the seed {twice[0]} twice")
    return seeds


def _counted(seeds: Any) -> Any:
    if type(seeds) is not int:
        return tuple(seeds) if isinstance(seeds, list) else seeds
    if not 1 <= seeds <= MOST_SEEDS:
        raise ValueError(f"should be a list, or a number of seeds from 1 to {MOST_SEEDS:,}, not {seeds}")
    return tuple(range(seeds))


MOST_SEEDS = 10_000
Count = Annotated[int, Setting(ge=1, le=MOST_SEEDS)]
Listed = Annotated[tuple[Seed, ...], Setting(json_schema_extra={"minItems": 1, "uniqueItems": True})]
Seeds = Annotated[
    tuple[Seed, ...], AfterValidator(_distinct), BeforeValidator(_counted, json_schema_input_type=Count | Listed)
]
"""Distinct seeds; a number n stands for 0 to n - 1."""
Number: TypeAlias = float  # SweepParameter has fields named float and int
Whole: TypeAlias = int

Direction = Literal["maximize", "minimize"]
OBJECTIVES: dict[str, Direction] = {
    "success_any": "maximize",
    "success_end": "maximize",
    "mean_success_any": "maximize",
    "mean_success_end": "maximize",
    "return": "maximize",
    "steps_to_50": "minimize",
    "steps_to_90": "minimize",
    "steps_to_95": "minimize",
}
"""Objectives of a trial and their directions. Each is a mean over the seeds.

success and return are those of the policy `last` in the final test. Trials have no final test: the last test counts.
mean_* is the mean over all tests, the area under the learning curve.
steps_to_* is the number of environment steps until the first test with that `end` success; a run that never reaches it
counts twice its steps (PAR2, penalised run time in algorithm configuration)."""
MEASURES = "measures."
"""Prefix of objectives that are measures of the environment. They come from the same test as success."""
DEFAULT_TRIALS = 20
MOST_COMBINATIONS = 100_000
"""Largest number of combinations of a grid, which are listed before the first trial."""


def directions(objectives: Sequence[str], measures: Sequence[Measure]) -> tuple[Direction, ...]:
    """maximize or minimize, for each objective. An environment's measure says whether smaller values are better.

    Raises UsageError for a measure that the environment does not declare.
    """
    declared: dict[str, Direction] = {
        f"{MEASURES}{one.name}": "minimize" if one.better == "smaller" else "maximize" for one in measures
    }
    for name in objectives:
        if name not in OBJECTIVES and name not in declared:
            hint = alternatives(name, [*OBJECTIVES, *declared])
            raise UsageError(f"the environment has no objective {name!r}", setting="sweep.objective", hint=hint)
    return tuple((OBJECTIVES | declared)[name] for name in objectives)


def label(value: object) -> str:
    """The label of a choice's value in the journal, in figures and in `when`."""
    return value if isinstance(value, str) else json.dumps(value)


class SweepParameter(Settings):
    """The search range of one setting: numbers, whole numbers, or a choice."""

    float: tuple[Number, Number] | None = Setting(None, description="lowest and highest value")
    int: tuple[Whole, Whole] | None = Setting(None, description="lowest and highest whole number")
    choice: list[Any] | dict[str, Any] | None = Setting(
        None, description="values to choose from; a mapping gives each value a name"
    )
    log: bool = Setting(False, description="whether to sample the logarithm uniformly")
    points: Whole | None = Setting(None, ge=2, le=10_000, description="number of values of a range in a grid")
    when: dict[str, Any] = Setting(
        {}, description="search only in trials in which these settings have this value, or one of these values"
    )

    @model_validator(mode="after")
    def _one_range_or_choice(self) -> Self:
        given = [name for name in ("float", "int", "choice") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"takes one of float, int and choice, not {' and '.join(given) or 'none'}")
        if self.choice is not None:
            if len(self.labels) < 2:
                raise ValueError("a choice needs at least two values")
            if len(set(self.labels)) < len(self.labels):
                raise ValueError("contains a choice twice")
            if self.log or self.points:
                raise ValueError("log and points are settings of a range, not of a choice")
            return self
        low, high = self.bounds
        if low >= high:
            raise ValueError(f"the lowest value {low:g} is not below the highest {high:g}")
        if self.log and low <= 0:
            raise ValueError(f"log needs values above 0, and the lowest is {low:g}")
        return self

    @property
    def bounds(self) -> tuple[Number, Number]:
        """The ends of a range."""
        bounds = self.float or self.int
        assert bounds is not None  # called only for ranges
        return bounds

    @property
    def choices(self) -> dict[str, Any]:
        """Label -> value; empty for a range."""
        if isinstance(self.choice, dict):
            return self.choice
        return {label(value): value for value in self.choice or ()}

    @property
    def labels(self) -> list[str]:
        """The labels of a choice, with duplicates."""
        return list(self.choice) if isinstance(self.choice, dict) else [label(value) for value in self.choice or ()]

    def grid(self) -> Sequence[Any]:
        """The values of a grid: a choice's labels, every whole number, or `points` values of a range."""
        if self.choice is not None:
            return self.labels
        low, high = self.bounds
        if self.int is not None and self.points is None:
            return range(self.int[0], self.int[1] + 1)
        count = self.points or 2
        if self.log:
            low, high = math.log(low), math.log(high)
        values = [low + (high - low) * place / (count - 1) for place in range(count)]
        values = [math.exp(value) for value in values] if self.log else values
        values[0], values[-1] = self.bounds  # exact, because exp(log(x)) rounds
        return list(dict.fromkeys(map(round, values))) if self.int is not None else values

    def value(self, drawn: Any) -> Any:
        """The setting's value for a sampled label or number."""
        return drawn if self.choice is None else self.choices[drawn]

    def accepted(self, condition: object) -> set[str]:
        """The labels of this choice that a `when` accepts; may contain unknown labels."""
        one = label(condition)
        if one in self.labels or not isinstance(condition, list):
            return {one}
        return {label(value) for value in condition}

    @model_serializer(mode="wrap")
    def _without_nulls(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Dump the range or the choice that is set. Nulls within a choice are values and remain."""
        return {key: value for key, value in serialize(self).items() if value is not None}


class Pruner(Settings):
    """Stops trials that are worse than others at the same step."""

    name: Literal["median"] = Setting("median", description="stop a trial whose best test so far is below the median")
    warmup: float = Setting(
        0.3, ge=0.3, lt=1, description="share of training.steps before which no trial is stopped; at least 0.3"
    )
    startup: int = Setting(5, ge=1, le=10**6, description="number of complete trials before a trial can be stopped")


class FinalSettings(Settings):
    """The final phase, on new seeds, because hyper-parameters overfit the seeds of their tuning.

    Source: Eimer et al. 2023, "Hyperparameters in Reinforcement Learning and How To Tune Them".
    """

    top: int = Setting(3, ge=1, le=1000, description="number of best trials that are tested on new seeds")
    seeds: int = Setting(3, ge=1, le=1000, description="number of new seeds that decide between them")
    report_seeds: int = Setting(
        5, ge=1, le=1000, description="number of other new seeds, on which the chosen trial is reported"
    )


def _objectives(value: str | tuple[str, ...]) -> str | tuple[str, ...]:
    names = (value,) if isinstance(value, str) else value
    for name in names:
        if name not in OBJECTIVES and not name.startswith(MEASURES):
            raise ValueError(f"there is no objective {name!r}; {alternatives(name, [*OBJECTIVES, f'{MEASURES}NAME'])}")
    if not names or len(set(names)) < len(names):
        raise ValueError("should contain at least one objective, and none twice")
    return value


class Sweep(Settings):
    """A search for good settings. Each trial is the spec with other values, run on the sweep's seeds."""

    space: dict[str, SweepParameter] = Setting(min_length=1, description="setting to search -> its range or choice")
    trials: int | None = Setting(
        None, ge=1, le=10**6, description=f"number of trials. Default: {DEFAULT_TRIALS}, or all combinations of a grid"
    )
    seeds: Seeds = Setting((0, 1), description="seeds of every trial")
    objective: Annotated[str | tuple[str, ...], AfterValidator(_objectives)] = Setting(
        "success_end", description=f"one or more of {', '.join(OBJECTIVES)}, measures.NAME"
    )
    sampler: Literal["tpe", "gp", "random", "grid"] = Setting(
        "tpe", description="Parzen estimators, Gaussian process, random values, or all combinations (at most 100,000)"
    )
    pruner: Pruner | None = Setting(None, description="stops trials early; null: off")
    seed: Seed = Setting(0, description="root of the sampler's random numbers")
    final: FinalSettings | None = Setting(None, description="choose and report the best trial on new seeds; null: off")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.pruner is not None and len(self.objectives) > 1:
            raise ValueError("the pruner compares one objective, and there are several; remove it")
        if self.sampler == "grid":
            without_points = [key for key, one in self.space.items() if one.float is not None and one.points is None]
            if without_points:
                raise ValueError(f"a grid needs `points` for {without_points[0]}, or a choice")
            if next(islice(self.combinations(), MOST_COMBINATIONS, None), None) is not None:
                raise ValueError(f"a grid of more than {MOST_COMBINATIONS:,} combinations; give ranges fewer `points`")
        return self

    @property
    def objectives(self) -> tuple[str, ...]:
        return (self.objective,) if isinstance(self.objective, str) else self.objective

    def order(self) -> list[str]:
        """The parameters, each after those in its `when`; without parameters in a circle."""
        ordered: dict[str, None] = {}
        while more := [
            key
            for key, one in self.space.items()
            if key not in ordered and all(on in ordered or on not in self.space for on in one.when)
        ]:
            ordered.update(dict.fromkeys(more))
        return list(ordered)

    def is_active(self, key: str, drawn: Mapping[str, Any]) -> bool:
        """Whether a parameter is searched in a trial with these sampled values."""
        conditions = self.space[key].when.items()
        return all(on in drawn and drawn[on] in self.space[on].accepted(value) for on, value in conditions)

    def combinations(self) -> Iterator[dict[str, Any]]:
        """The values of each trial of the grid, in order, without inactive parameters."""
        yield from self._combinations(self.order(), {})

    def _combinations(self, rest: list[str], drawn: dict[str, Any]) -> Iterator[dict[str, Any]]:
        if not rest:
            yield dict(drawn)
            return
        key, *later = rest
        values = self.space[key].grid() if self.is_active(key, drawn) else ()
        for value in values:
            yield from self._combinations(later, {**drawn, key: value})
        if not values:
            yield from self._combinations(later, drawn)


SEARCHABLE = ("robot", "task", "environment", "agent", "buffer", RANDOMIZATION, "demonstrations", "training")
"""Keys of a spec below which settings can be searched."""
FIXED_SETTINGS = {
    "training.steps": "every trial has the same budget",
    "training.device": "it does not change what is learned",
    "training.threads": "it does not change what is learned",
    "testing": "every trial is tested alike",
    "orchestrator": "it says how the machine is shared",
    "seeds": "sweep.seeds says on which seeds",
    "name": "the sweep names its trials",
}
"""Settings that cannot be searched -> the reason."""
VALIDATED_COMBINATIONS = 200
"""Largest number of combinations, of the choices that a parameter depends on, with which it is validated."""


def application_order(keys: Iterable[str]) -> list[str]:
    """Parameters in the order of merging: those that replace a whole part before those inside it."""
    return sorted(keys, key=lambda key: (len(segments(key)), segments(key)[-1] != "name"))


def space_problems(space: Node, sweep: Sweep, problems_of: Callable[[Sequence[Node]], list[Problem]]) -> list[Problem]:
    """The problems of a sweep's search space, at the number or the choice.

    Both ends of each range and every value of each choice are validated: `problems_of` gives the problems of the spec
    without its sweep, with changes on top.
    """
    if problems := [*_wrong_keys(space), *_wrong_conditions(space, sweep)]:
        return problems
    values = {key: _values(space[key], sweep, key) for key in sweep.space}
    wrong: dict[Problem, None] = {}
    refused: set[tuple[str, Any]] = set()  # so that dependent parameters do not report more problems
    for key in sorted(sweep.space, key=lambda one: len(_depends(sweep, one))):
        for drawn in _combinations(sweep, key):
            if refused & drawn.items():
                continue
            above = application_order(drawn)
            changes = [values[name][drawn[name]].under(name) for name in above]
            if off := _without_settings(above, changes, key):
                what, hint = f"{off} has no such setting when it is {drawn[off]!r}", f"add when: {{{off}: ...}}"
                wrong[Problem(space[key].place, f"sweep.space.{key}", what, hint)] = None
                continue
            for value, node in values[key].items():
                if problems := problems_of([*changes, node.under(key)]):
                    wrong.update(dict.fromkeys(_at_parameter(space[key], key, problem) for problem in problems))
                    refused.add((key, value))
    return list(wrong)


def _without_settings(above: Sequence[str], changes: Sequence[Node], key: str) -> str | None:
    """The choice above a parameter whose value has no settings, e.g. null; None if all have."""
    for name, change in zip(above, changes, strict=True):
        node = change.get(*segments(name))
        if key.startswith(f"{name}.") and node is not None and node.mapping is None:
            return name
    return None


def _at_parameter(node: Node, key: str, problem: Problem) -> Problem:
    """The problem, moved to the parameter if it is not inside."""
    if any(problem.where in (below.at, below.key) for below in node.walk()):
        return problem
    return Problem(node.place, f"sweep.space.{key}", f"{problem.setting}: {problem.what}", problem.hint)


def _wrong_keys(space: Node) -> Iterator[Problem]:
    for key, node in (space.mapping or {}).items():
        path = f"sweep.space.{key}"
        first = key.partition(".")[0]
        fixed = next(
            (why for prefix, why in FIXED_SETTINGS.items() if key == prefix or key.startswith(f"{prefix}.")), None
        )
        if fixed is not None:
            yield Problem(node.place, path, f"cannot be searched: {fixed}", "remove it")
        elif first not in SEARCHABLE:
            yield Problem(node.place, path, "no such setting", alternatives(first, SEARCHABLE))
        elif not all(segments(key)):
            yield Problem(node.place, path, "is not a path of keys", "write e.g. agent.learning_rate")


def _wrong_conditions(space: Node, sweep: Sweep) -> Iterator[Problem]:
    order = sweep.order()
    for key, parameter in sweep.space.items():
        for on, condition in parameter.when.items():
            node = space[key]["when"][on]
            path = f"sweep.space.{key}.when.{on}"
            other = sweep.space.get(on)
            if other is None or other.choice is None:
                what = "is not a parameter of this sweep" if other is None else "is a range, not a choice"
                names = [name for name, one in sweep.space.items() if one.choice is not None and name != key]
                hint = alternatives(on, names) if names else "name a choice of this sweep"
                yield Problem(node.place, path, what, hint)
                continue
            for unknown in sorted(other.accepted(condition).difference(other.labels)):
                what = f"{on} is never {unknown!r}"
                yield Problem(node.at, path, what, alternatives(unknown, other.labels))
        if key not in order:
            place = space[key]["when"].place
            yield Problem(place, f"sweep.space.{key}.when", "is a circle of conditions", "remove one of them")


def _combinations(sweep: Sweep, key: str) -> Iterator[dict[str, Any]]:
    """The combinations of the choices that a parameter depends on, with which it is active."""
    choices = Sweep.model_construct(space={name: sweep.space[name] for name in _depends(sweep, key)})
    for drawn in islice(choices.combinations(), VALIDATED_COMBINATIONS):
        if sweep.is_active(key, drawn):
            yield drawn


def _depends(sweep: Sweep, key: str) -> list[str]:
    """The choices that determine whether a parameter is active, or the plugin or mapping that contains it."""
    choices: dict[str, None] = {}
    waiting = [key]
    while waiting:
        one = waiting.pop()
        around = [
            name
            for name, other in sweep.space.items()
            if other.choice is not None and name != one and one.startswith(f"{name.removesuffix('.name')}.")
        ]
        more = [name for name in (*around, *sweep.space[one].when) if name != key and name not in choices]
        choices.update(dict.fromkeys(more))
        waiting.extend(more)
    return list(choices)


def _values(node: Node, sweep: Sweep, key: str) -> dict[Any, Node]:
    """The values to validate (both ends of a range, or all labels of a choice), and their nodes in the search space."""
    parameter = sweep.space[key]
    kind = next(kind for kind in ("float", "int", "choice") if getattr(parameter, kind) is not None)
    nodes = node[kind].items if node[kind].mapping is None else list(node[kind].value.values())
    values = parameter.bounds if parameter.choice is None else parameter.labels
    return {value: below.with_key(node.key) for value, below in zip(values, nodes or (), strict=True)}


Mode = Literal["zero_shot", "fine_tune", "scratch"]
VARIANT_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,23}$"
"""Pattern of the names of variants, which are parts of the names of run folders."""
VARIANT_KEYS = ("robot", "task", "environment")
"""Keys of a spec below which variants may differ."""
FINE_TUNE_KEYS = ("agent", "buffer", "demonstrations", "training", "testing.interval", "testing.final_episodes")
"""Keys of a spec below which fine-tuning may differ from training from scratch."""


def _below(allowed: tuple[str, ...], what: str) -> AfterValidator:
    """Checks the key of a setting. An error is reported at the key."""

    def check(key: str) -> str:
        if not f"{key}.".startswith(tuple(f"{one}." for one in allowed)):
            raise ValueError(f"{what} cannot change {key}, only {', '.join(allowed)}")
        return key

    return AfterValidator(check)


VariantKey = Annotated[str, _below(VARIANT_KEYS, "a variant")]
FineTuneKey = Annotated[str, _below(FINE_TUNE_KEYS, "fine_tune")]


class Transfer(Settings):
    """A matrix: each variant is a target for the policies of the sources, and a source itself unless `sources` says."""

    robots: tuple[str, ...] | None = Setting(None, description="names of the robots to transfer between")
    variants: dict[Annotated[str, StringConstraints(pattern=VARIANT_PATTERN)], dict[VariantKey, Any]] | None = Setting(
        None, description="alternative to robots: name -> settings, e.g. mujoco: {environment.engine: mujoco}"
    )
    sources: tuple[str, ...] | None = Setting(
        None, description="the variants whose policies are tested on the others; null: all"
    )
    references: tuple[str, ...] = Setting(
        (), description="further variants that are only trained, to compare training there with transfer"
    )
    modes: tuple[Mode, ...] = Setting(
        ("zero_shot", "fine_tune", "scratch"),
        description="zero_shot: test a source's policy on the target; fine_tune: train it further on the target; "
        "scratch: compare fine-tuning with training on the target from scratch",
    )
    fine_tune: dict[FineTuneKey, Any] = Setting(
        {}, description="settings of fine-tuning that differ from the spec's, e.g. training.steps: 100000"
    )
    threshold: float = Setting(0.95, gt=0, le=1, description="success ratio that defines the time to threshold")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.robots is None) == (self.variants is None):
            raise ValueError("takes one of robots and variants")
        for name in self.robots or ():
            if self.robots is not None and self.robots.count(name) > 1:
                raise ValueError(f"names the robot {name} twice")
        seen: list[tuple[str, Mapping[str, Any]]] = []
        for name, settings in self.settings.items():
            twin = next((other for other, known in seen if known == settings), None)
            if twin is not None:
                raise ValueError(f"the variants {twin} and {name} have the same settings")
            seen.append((name, settings))
        if len(seen) < 2:
            raise ValueError(f"needs two {'robots' if self.robots is not None else 'variants'} or more")
        if len(set(self.modes)) < len(self.modes):
            raise ValueError("names a mode twice")
        if not {"zero_shot", "fine_tune"} & set(self.modes):
            raise ValueError("transfers nothing: add zero_shot or fine_tune to modes")
        if self.fine_tune and "fine_tune" not in self.modes:
            raise ValueError("no mode uses fine_tune: add fine_tune to modes, or remove it")
        return self

    @model_validator(mode="after")
    def _knows_sources(self) -> Self:
        for name in (*(self.sources or ()), *self.references):
            if name not in self.settings:
                raise ValueError(f"{name} is not a variant; variants are {', '.join(self.settings)}")
        if self.sources == ():
            raise ValueError("needs a source, or sources: null for all")
        if self.references and "scratch" not in self.modes:
            raise ValueError("has references that no mode uses: add scratch to modes")
        return self

    @property
    def settings(self) -> dict[str, dict[str, Any]]:
        """Variant -> its settings by key path."""
        if self.robots is not None:
            return {name: {"robot.name": name} for name in self.robots}
        return self.variants or {}

    @property
    def source_names(self) -> tuple[str, ...]:
        """The sources, in the order of the variants."""
        return tuple(name for name in self.settings if self.sources is None or name in self.sources)

    @property
    def trained(self) -> tuple[str, ...]:
        """Sources and references: the variants with runs of their own."""
        return tuple(name for name in self.settings if name in (*self.source_names, *self.references))

    def place(self, variant: str) -> str:
        """The key path in the spec that makes a variant."""
        return "transfer.robots" if self.robots is not None else f"transfer.variants.{variant}"
