from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from karolos.core.parameters import RandomizedParameter
from karolos.core.seeding import Generator
from karolos.environments.distributions import Choice, LogUniform, Normal, UniformDistribution
from karolos.environments.randomization import Randomization
from karolos.errors import PluginError, RunError, UsageError

DECLARED = {
    "task.gravity": RandomizedParameter("m/s2", -9.81, -20.0, 0.0),
    "robot.link_mass": RandomizedParameter("1", 1.0, 0.5, 2.0),
}


def generator(seed: int = 0) -> Generator:
    return np.random.Generator(np.random.PCG64(seed))


def uniform(low: float, high: float) -> UniformDistribution:
    return UniformDistribution(UniformDistribution.Settings(low=low, high=high))


@pytest.mark.parametrize("value", [None, "low", np.zeros(1)])
def test_a_value_that_is_no_number_is_told_at_its_parameter(monkeypatch, value):
    monkeypatch.setattr(UniformDistribution, "draw", lambda *_: value)
    with pytest.raises(PluginError, match=r"^randomization\.task\.gravity: .*, which is no float"):
        Randomization({"task.gravity": uniform(-10, -9)}, DECLARED)


@given(st.floats(-5, 5), st.floats(0, 5), st.integers(0, 1000))
def test_uniform_stays_between_its_bounds(low, width, seed):
    value = uniform(low=low, high=low + width).draw(generator(seed))
    assert low <= value <= low + width


@given(st.floats(1e-3, 10), st.floats(1, 1000), st.integers(0, 1000))
def test_log_uniform_stays_between_its_bounds(low, factor, seed):
    value = LogUniform(LogUniform.Settings(low=low, high=low * factor)).draw(generator(seed))
    assert low <= value <= low * factor


def test_distributions_have_the_moments_they_say():
    draws = generator()

    def mean(draw: Callable[[Generator], float]) -> tuple[float, float]:
        values = [draw(draws) for _ in range(4000)]
        return float(np.mean(values)), float(np.std(values))

    assert mean(Normal(Normal.Settings(mean=3.0, std=0.5)).draw) == pytest.approx((3.0, 0.5), rel=0.05)
    assert mean(uniform(low=0.0, high=2.0).draw)[0] == pytest.approx(1.0, rel=0.05)
    logarithm = LogUniform(LogUniform.Settings(low=0.1, high=10.0))
    assert mean(lambda random: float(np.log10(logarithm.draw(random))))[0] == pytest.approx(0.0, abs=0.05)
    weighted = Choice(Choice.Settings(values=(0.0, 1.0), weights=(1.0, 3.0)))
    assert mean(weighted.draw)[0] == pytest.approx(0.75, rel=0.05)
    assert {Choice(Choice.Settings(values=(1.0, 5.0))).draw(draws) for _ in range(50)} == {1.0, 5.0}


@pytest.mark.parametrize(
    "make",
    [
        lambda: Normal.Settings(mean=0.0, std=-0.1),
        lambda: UniformDistribution.Settings(low=1.0, high=0.0),
        lambda: LogUniform.Settings(low=0.0, high=1.0),
        lambda: LogUniform.Settings(low=2.0, high=1.0),
        lambda: Choice.Settings(values=()),
        lambda: Choice.Settings(values=(1.0, 2.0), weights=(1.0,)),
        lambda: Choice.Settings(values=(1.0,), weights=(0.0,)),
        lambda: Choice.Settings(values=(1.0, 2.0), weights=(2.0, -1.0)),
        lambda: Normal.Settings(mean=float("nan"), std=1.0),
    ],
)
def test_distribution_that_makes_no_sense_is_refused(make):
    with pytest.raises(ValidationError):
        make()


def test_values_outside_the_declared_range_are_drawn_again():
    wide = Randomization({"robot.link_mass": Normal(Normal.Settings(mean=1.0, std=3.0))}, DECLARED)
    draws = generator()
    values = [wide.draw(draws)[0] for _ in range(300)]
    assert min(values) >= 0.5
    assert max(values) <= 2.0
    assert len(set(values)) == 300, "cut off, not heaped up at the bounds"


def test_distribution_that_always_misses_is_a_named_error():
    with pytest.raises(RunError, match=r"randomization.robot.link_mass.*allowed is 0.5 to 2$"):
        Randomization({"robot.link_mass": uniform(low=5.0, high=6.0)}, DECLARED)


@pytest.mark.parametrize("values", [(5.0,), (1.0, 5.0)])
def test_listed_value_outside_the_range_is_refused_not_left_out(values):
    with pytest.raises(UsageError, match=r"robot.link_mass: 5 lies outside the allowed range; allowed is 0.5 to 2$"):
        Randomization({"robot.link_mass": Choice(Choice.Settings(values=values))}, DECLARED)


def test_undeclared_parameter_names_the_closest_and_what_is_declared():
    with pytest.raises(UsageError, match=r"did you mean 'robot.link_mass'.*task.gravity"):
        Randomization({"robot.link_mas": Normal(Normal.Settings(mean=1.0, std=0.1))}, DECLARED)


def test_order_of_the_spec_does_not_change_what_is_drawn():
    mass, gravity = Normal(Normal.Settings(mean=1.0, std=0.1)), Normal(Normal.Settings(mean=-9.81, std=0.1))
    one = Randomization({"robot.link_mass": mass, "task.gravity": gravity}, DECLARED)
    other = Randomization({"task.gravity": gravity, "robot.link_mass": mass}, DECLARED)
    assert one.layout == other.layout
    assert one.draw(generator()) == other.draw(generator())


def test_nothing_to_draw_draws_nothing():
    draws = generator()
    before = draws.bit_generator.state
    assert Randomization({}, DECLARED).draw(draws) == []
    assert draws.bit_generator.state == before
