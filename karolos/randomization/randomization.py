"""Domain randomization: draws the values that robot and task then apply themselves."""

from __future__ import annotations

from collections.abc import Mapping

from ..core import Field, Layout
from ..core.seeding import Generator
from ..errors import RunError, UsageError
from ..registry import alternatives
from .distribution import Distribution
from .parameter import Parameter

ATTEMPTS = 100


class Randomization:
    """Which parameters are drawn at each reset, and from what.

    A value outside the range that the parameter declares is drawn again: the distribution is cut off, not heaped up
    at the bounds.

    Args:
        distributions: by name of the parameter with its part in front, e.g. "task.gravity".
        declared: what the parts let change, by the same names.

    Raises:
        UsageError: a parameter that no part declares.
    """

    def __init__(self, distributions: Mapping[str, Distribution], declared: Mapping[str, Parameter]) -> None:
        for name in distributions:
            if name not in declared:
                raise UsageError(
                    f"no parameter is called {name!r}",
                    where=f"randomization.{name}",
                    hint=alternatives(name, sorted(declared), what="declared"),
                )
        self._drawn = tuple((name, distributions[name], declared[name]) for name in sorted(distributions))
        self.layout = Layout(tuple(Field(name, 1, parameter.unit) for name, _, parameter in self._drawn))
        """The parameters in the order in which `draw` gives them."""

    def draw(self, generator: Generator) -> list[float]:
        """A value for each parameter. Raises RunError when a distribution keeps missing the allowed range."""
        return [self._one(name, distribution, parameter, generator) for name, distribution, parameter in self._drawn]

    def _one(self, name: str, distribution: Distribution, parameter: Parameter, generator: Generator) -> float:
        for _ in range(ATTEMPTS):
            value = distribution.draw(generator)
            if parameter.low <= value <= parameter.high:
                return value
        raise RunError(
            f"{ATTEMPTS} values in a row lie outside the allowed range, the last one {value:g} {parameter.unit}",
            where=f"randomization.{name}",
            hint=f"allowed is {parameter.low:g} to {parameter.high:g} {parameter.unit}",
        )
