"""The `sweep` of a spec: which settings are searched, how, and by what they are judged."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, model_validator
from pydantic import Field as Setting

from ..core import Settings

Number: TypeAlias = float  # in Parameter the words float and int are settings
Whole: TypeAlias = int

OBJECTIVES: dict[str, Literal["maximize", "minimize"]] = {
    "success_any": "maximize",
    "success_end": "maximize",
    "mean_success_any": "maximize",
    "mean_success_end": "maximize",
    "return": "maximize",
    "steps_to_50": "minimize",
    "steps_to_90": "minimize",
    "steps_to_95": "minimize",
}
"""What a trial can be judged by, each the mean over its seeds: success and return of the last test; mean_*: of all
tests, which is the area under the learning curve; steps_to_*: environment steps to the first test with that `any`
success, a run that never got there counting twice its steps (PAR2, penalised run time in algorithm configuration)."""
DEFAULT_TRIALS = 20


def label(value: object) -> str:
    """How a choice is called in the journal, in figures and in `when`."""
    return value if isinstance(value, str) else json.dumps(value)


class Parameter(Settings):
    """Where one setting is searched: a range of numbers, of whole numbers, or a choice."""

    float: tuple[Number, Number] | None = Setting(None, description="lowest and highest value")
    int: tuple[Whole, Whole] | None = Setting(None, description="lowest and highest whole number")
    choice: list[Any] | dict[str, Any] | None = Setting(
        None, description="values to choose among; as a mapping, each under a name of its own"
    )
    log: bool = Setting(False, description="whether orders of magnitude are equally likely")
    points: Whole | None = Setting(None, ge=2, description="how many values of a range a grid takes")
    when: dict[str, Any] = Setting(
        {}, description="searched only in trials in which these choices take this value, or one of these values"
    )

    @model_validator(mode="after")
    def _sound(self) -> Parameter:
        given = [name for name in ("float", "int", "choice") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"takes one of float, int and choice, not {' and '.join(given) or 'none'}")
        if self.choice is not None:
            if len(self.labels) < 2:
                raise ValueError("a choice needs at least two values")
            if len(set(self.labels)) < len(self.labels):
                raise ValueError("names a value of its choice twice")
            if self.log or self.points:
                raise ValueError("log and points say nothing to a choice")
            return self
        low, high = self.bounds
        if low >= high:
            raise ValueError(f"the lowest value {low:g} does not lie below the highest {high:g}")
        if self.log and low <= 0:
            raise ValueError(f"log needs values above 0, and the lowest is {low:g}")
        return self

    @property
    def bounds(self) -> tuple[Number, Number]:
        """Of a range."""
        bounds = self.float or self.int
        assert bounds is not None  # asked of ranges only
        return bounds

    @property
    def choices(self) -> dict[str, Any]:
        """Label -> value; empty for a range."""
        if isinstance(self.choice, dict):
            return self.choice
        return {label(value): value for value in self.choice or ()}

    @property
    def labels(self) -> list[str]:
        """What a choice chooses among; a value given twice stands here twice."""
        return list(self.choice) if isinstance(self.choice, dict) else [label(value) for value in self.choice or ()]

    def grid(self) -> list[Any]:
        """The values that a grid takes: a choice's labels, every whole number, or `points` values of a range."""
        if self.choice is not None:
            return self.labels
        low, high = self.bounds
        if self.int is not None and self.points is None:
            return list(range(self.int[0], self.int[1] + 1))
        count = self.points or 2
        if self.log:
            low, high = math.log(low), math.log(high)
        values = [low + (high - low) * place / (count - 1) for place in range(count)]
        values = [math.exp(value) for value in values] if self.log else values
        values[0], values[-1] = self.bounds  # exactly, whatever exp(log) makes of them
        return list(dict.fromkeys(map(round, values))) if self.int is not None else values

    def value(self, drawn: Any) -> Any:
        """The setting's value for what was drawn: a label of a choice, or a number."""
        return drawn if self.choice is None else self.choices[drawn]

    def accepted(self, condition: object) -> set[str]:
        """The labels of this choice that a `when` asks for; may name some that it does not have."""
        one = label(condition)
        if one in self.labels or not isinstance(condition, list):
            return {one}
        return {label(value) for value in condition}

    def dump(self) -> dict[str, Any]:
        """As it stands in a spec. Nulls within a choice are values and stay."""
        return {key: value for key, value in self.model_dump(mode="json").items() if value is not None}


class Pruner(Settings):
    """Stops trials early that do worse than others did at the same step."""

    name: Literal["median"] = Setting("median", description="stop a trial whose best test so far lies below the median")
    warmup: float = Setting(
        0.3, ge=0.3, lt=1, description="share of training.steps before which no trial is stopped; 0.3 at least"
    )
    startup: int = Setting(5, ge=1, description="trials that have to be complete before one is stopped")


class Final(Settings):
    """What is done with the best trials: hyper-parameters overfit the seeds that they were tuned on (Eimer et al. 2023,
    "Hyperparameters in Reinforcement Learning and How To Tune Them").
    """

    top: int = Setting(3, ge=1, description="best trials among which is chosen")
    seeds: int = Setting(3, ge=1, description="fresh seeds to choose by")
    report_seeds: int = Setting(
        5, ge=1, description="further seeds, used for nothing else, to report the chosen one on"
    )


def _distinct_seeds(seeds: tuple[int, ...]) -> tuple[int, ...]:
    if not seeds or len(set(seeds)) < len(seeds):
        raise ValueError("should name at least one seed, none twice")
    return seeds


def _objectives(value: str | tuple[str, ...]) -> str | tuple[str, ...]:
    names = (value,) if isinstance(value, str) else value
    for name in names:
        if name not in OBJECTIVES:
            raise ValueError(f"there is no objective {name!r}; there are {', '.join(OBJECTIVES)}")
    if not names or len(set(names)) < len(names):
        raise ValueError("should name at least one objective, none twice")
    return value


class Sweep(Settings):
    """A search for good settings: each trial is this spec with other values, run on the sweep's seeds."""

    space: dict[str, Parameter] = Setting(min_length=1, description="setting to search -> where")
    trials: int | None = Setting(
        None, ge=1, description=f"how many trials. Default: {DEFAULT_TRIALS}, or the whole of a grid"
    )
    seeds: Annotated[tuple[Annotated[int, Setting(ge=0)], ...], AfterValidator(_distinct_seeds)] = Setting(
        (0, 1), description="of every trial"
    )
    objective: Annotated[str | tuple[str, ...], AfterValidator(_objectives)] = Setting(
        "success_end", description=f"what trials are judged by, or several: {', '.join(OBJECTIVES)}"
    )
    sampler: Literal["tpe", "gp", "random", "grid"] = Setting(
        "tpe", description="how values are drawn: Parzen estimators, Gaussian process, at random, every combination"
    )
    pruner: Pruner | None = Setting(None, description="what stops trials early; null: nothing")
    seed: int = Setting(0, ge=0, description="root of the sampler's random numbers")
    final: Final | None = Setting(
        None, description="how the best trial is chosen and reported on fresh seeds; null: by its trial alone"
    )

    @model_validator(mode="after")
    def _fitting(self) -> Sweep:
        if self.pruner is not None and len(self.objectives) > 1:
            raise ValueError("the pruner compares one objective, and there are several; remove it")
        if self.sampler == "grid":
            loose = [key for key, one in self.space.items() if one.float is not None and one.points is None]
            if loose:
                raise ValueError(f"a grid needs `points` for {loose[0]}, or a choice")
        return self

    @property
    def objectives(self) -> tuple[str, ...]:
        return (self.objective,) if isinstance(self.objective, str) else self.objective

    def order(self) -> list[str]:
        """The parameters, each after those that its `when` names; parameters on a circle are left out."""
        found: dict[str, None] = {}
        while more := [
            key
            for key, one in self.space.items()
            if key not in found and all(on in found or on not in self.space for on in one.when)
        ]:
            found.update(dict.fromkeys(more))
        return list(found)

    def is_active(self, key: str, drawn: Mapping[str, Any]) -> bool:
        """Whether a parameter is searched in a trial in which its conditions have drawn this."""
        conditions = self.space[key].when.items()
        return all(on in drawn and drawn[on] in self.space[on].accepted(value) for on, value in conditions)

    def combinations(self) -> Iterator[dict[str, Any]]:
        """What each trial of the grid draws, in order; a parameter that is not active is not drawn."""
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

    def dump(self) -> dict[str, Any]:
        """As it stands in a spec, every default filled in."""
        plain = self.model_dump(mode="json")
        return {**plain, "space": {key: one.dump() for key, one in self.space.items()}}
