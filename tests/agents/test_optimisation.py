"""Adam over vectors: schedules, cut gradients, and a state that goes on."""

from __future__ import annotations

import pytest
import torch
from pydantic import ValidationError

from karolos.agents.optimisation import Adam, OptimiserSettings
from karolos.core.schedules import Linear


def test_the_learning_rate_falls_with_the_steps_and_stays() -> None:
    settings = OptimiserSettings(learning_rate=1.0, learning_rate_end=0.5, learning_rate_updates=2)
    optimiser = Adam(torch.zeros(4), settings.rate)
    found = []
    for _ in range(4):
        optimiser.step(torch.ones(4))
        found.append(optimiser.learning_rate)
    assert found == [1.0, 0.75, 0.5, 0.5]


def test_the_first_step_has_the_length_of_the_learning_rate() -> None:
    vector = torch.zeros(4)
    Adam(vector, Linear(0.1, 0.0, 10)).step(torch.full((4,), 3.0))
    torch.testing.assert_close(vector, torch.full((4,), -0.1))


def test_longer_gradients_are_cut_and_shorter_ones_left() -> None:
    optimiser = Adam(torch.zeros(4), 0.1, norm=1.0)
    long, short = torch.full((4,), 3.0), torch.full((4,), 0.1)
    assert optimiser.step(long, "norm", report=True)["norm"].item() == pytest.approx(6)
    assert torch.linalg.vector_norm(long).item() == pytest.approx(1)
    assert optimiser.step(short, "norm", report=True)["norm"].item() == pytest.approx(0.2)
    torch.testing.assert_close(short, torch.full((4,), 0.1))


def test_a_schedule_goes_on_where_it_stopped() -> None:
    whole, first, second = ((vector := torch.zeros(4), Adam(vector, Linear(0.1, 0.0, 6))) for _ in range(3))
    for step in range(6):
        gradient = torch.arange(4.0) - step
        whole[1].step(gradient.clone())
        if step == 3:
            second[0].copy_(first[0])
            second[1].load_state(first[1].state())
        (first if step < 3 else second)[1].step(gradient.clone())
    assert torch.equal(whole[0], second[0])
    assert whole[1].learning_rate == second[1].learning_rate


def test_half_a_schedule_is_refused() -> None:
    with pytest.raises(ValidationError, match="go together"):
        OptimiserSettings(learning_rate_end=1e-4)
