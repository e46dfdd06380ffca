"""Domain randomization: samples the values that robot and task then apply."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real

import numpy as np

from ..core import Field, Generator, Layout
from ..core.parameters import Drawn, Probability, RandomizedParameter, drawn_settings
from ..errors import PluginError, RunError, UsageError, alternatives
from .distributions import Distribution

__all__ = ["Drawn", "Probability", "Randomization", "RandomizedParameter", "drawn_settings"]

DRAW_ATTEMPTS = 100


class Randomization:
    """Samples parameters from their distributions at each reset.

    A value outside the range that the parameter declares is sampled again, so the distribution is truncated. A listed
    value (a constant, a choice) outside the range is refused.

    Args:
        distributions: by name of the parameter with its part in front, e.g. "task.gravity".
        declared: the parameters of robot and task, by the same names.

    Raises:
        UsageError: a parameter that neither robot nor task declares, or a listed value outside its range.
        RunError: a distribution that misses the allowed range.
    """

    def __init__(self, distributions: Mapping[str, Distribution], declared: Mapping[str, RandomizedParameter]) -> None:
        for name, distribution in distributions.items():
            if name not in declared:
                raise UsageError(
                    f"no parameter is called {name!r}",
                    setting=f"randomization.{name}",
                    hint=alternatives(name, sorted(declared), what="declared"),
                )
            for value in distribution.listed:
                if not declared[name].low <= value <= declared[name].high:
                    raise UsageError(
                        f"{declared[name].quantity(value)} lies outside the allowed range",
                        setting=f"randomization.{name}",
                        hint=declared[name].allowed,
                    )
        self._drawn = tuple((name, distributions[name], declared[name]) for name in sorted(distributions))
        self.layout = Layout(tuple(Field(name, 1, parameter.unit) for name, _, parameter in self._drawn))
        """The parameters in the order of the values that `draw` returns."""
        self.draw(np.random.Generator(np.random.PCG64(0)))  # refuses a bad distribution before a run begins

    def draw(self, generator: Generator) -> list[float]:
        """A value for each parameter.

        Raises RunError if a distribution keeps missing the allowed range, PluginError if it gives no number.
        """
        return [self._draw(name, distribution, parameter, generator) for name, distribution, parameter in self._drawn]

    @staticmethod
    def _draw(name: str, distribution: Distribution, parameter: RandomizedParameter, generator: Generator) -> float:
        for _ in range(DRAW_ATTEMPTS):
            value = distribution.draw(generator)
            if not isinstance(value, Real):
                what, hint = f"its distribution gives {value!r}, which is no float", "let `draw` return a Python float"
                raise PluginError(what, setting=f"randomization.{name}", hint=hint)
            if parameter.low <= value <= parameter.high:
                return value
        raise RunError(
            f"{DRAW_ATTEMPTS} values in a row lie outside the allowed range, the last one {parameter.quantity(value)}",
            setting=f"randomization.{name}",
            hint=parameter.allowed,
        )
