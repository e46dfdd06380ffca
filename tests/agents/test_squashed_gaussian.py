"""The policy's distribution against torch.distributions."""

import numpy as np
import pytest
import torch
from torch.distributions import Independent, Normal, TanhTransform, TransformedDistribution

from karolos.agents.squashed_gaussian import LOG_STD_BOUNDS, squashed


def noise_for(head: torch.Tensor, seed: int) -> torch.Tensor:
    return torch.randn(head.shape[0], head.shape[1] // 2, generator=torch.Generator().manual_seed(seed))


def test_log_probability_is_that_of_a_tanh_transformed_gaussian():
    head = 0.4 * torch.randn((200, 6), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    drawn = squashed(head, noise_for(head, 1).double())
    mean, log_std = head.chunk(2, -1)
    reference = TransformedDistribution(Normal(mean, log_std.exp()), TanhTransform(cache_size=1))
    expected = Independent(reference, 1).log_prob(drawn.action)
    torch.testing.assert_close(drawn.log_probability(), expected, rtol=1e-4, atol=1e-4)


def test_the_gradient_is_that_of_autograd():
    head = 2 * torch.randn((50, 6), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    head.requires_grad_()
    drawn = squashed(head, noise_for(head, 1).double())
    assert not drawn.unclamped.all()
    for_action, for_log_probability = noise_for(head, 2).double(), noise_for(head, 3)[:, 0].double()
    loss = (drawn.action * for_action).sum() + (drawn.log_probability() * for_log_probability).sum()
    found = drawn.backward(for_action, for_log_probability)
    torch.testing.assert_close(found, torch.autograd.grad(loss, head)[0])


def test_log_probability_and_its_gradient_stay_finite_where_tanh_saturates():
    head = torch.tensor([[40.0, -40.0, 2.0, 9.0]])
    drawn = squashed(head, noise_for(head, 0))
    assert drawn.action.abs().min() == 1
    assert torch.isfinite(drawn.log_probability()).all()
    assert torch.isfinite(drawn.backward(torch.ones(1, 2), torch.ones(1))).all()


@pytest.mark.parametrize(("log_std", "clamped"), [(-50.0, LOG_STD_BOUNDS[0]), (50.0, LOG_STD_BOUNDS[1]), (0.5, 0.5)])
def test_spread_is_clamped(log_std, clamped):
    head = torch.tensor([[0.0, log_std]]).expand(50_000, 2)
    unbounded = torch.atanh(squashed(head, noise_for(head, 0)).action.double())
    quartiles = np.quantile(unbounded.numpy(), (0.25, 0.75))
    assert np.ptp(quartiles) / 1.349 == pytest.approx(np.exp(clamped), rel=0.05)
