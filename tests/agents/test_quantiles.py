"""Quantile critics: their loss and targets against the formulas written out, and that they learn."""

import numpy as np
import pytest
import torch
from support.parts import batch, make, signature

from karolos.agents.actor_critic import QuantileCritic, Quantiles
from karolos.agents.inputs import tensor_batch
from karolos.agents.sac import SAC


def written_out(values: np.ndarray, targets: np.ndarray, weight: np.ndarray) -> float:
    """The loss of Dabney et al. 2018, equation 10, number by number."""
    members, rows, quantiles = values.shape
    total = 0.0
    for member in range(members):
        for row in range(rows):
            for j in range(quantiles):
                for y in targets[row]:
                    u = y - values[member, row, j]
                    huber = 0.5 * u * u if abs(u) <= 1 else abs(u) - 0.5
                    tau = (2 * j + 1) / (2 * quantiles)
                    share = weight[row] / (rows * quantiles * targets.shape[1])
                    total += share * abs(tau - float(u < 0)) * huber
    return total


def test_the_loss_is_the_quantile_huber_loss_and_the_gradient_is_its_own():
    generator = np.random.default_rng(0)
    values, targets = generator.normal(size=(2, 3, 4)) * 2, np.sort(generator.normal(size=(3, 7)) * 2, axis=1)
    weight = np.array([1.0, 0.5, 0.0])
    critic = QuantileCritic(Quantiles(quantiles=4))
    loss, gradient = critic.loss(torch.tensor(values), torch.tensor(targets), torch.tensor(weight) / len(weight))
    assert loss.item() == pytest.approx(written_out(values, targets, weight))
    slopes = np.zeros_like(values)
    for place in np.ndindex(values.shape):
        step = np.zeros_like(values)
        step[place] = 1e-6
        above, below = (written_out(values + sign * step, targets, weight) for sign in (1, -1))
        slopes[place] = (above - below) / 2e-6
    np.testing.assert_allclose(gradient, slopes, atol=1e-6)


def test_targets_leave_out_the_largest_quantiles_of_both_critics_together():
    agent = make(SAC, critic={"quantiles": 5, "drop": 1})
    data = batch(6, signature(), discount=0.5)
    inputs = tensor_batch(data, agent.normaliser, agent.device)
    drawn = agent.draw(inputs.next_input)
    found = agent.targets(inputs, drawn.action)
    both = agent.target(torch.cat((inputs.next_input, drawn.action), 1)).numpy()
    kept = np.sort(np.concatenate((both[0], both[1]), axis=1), axis=1)[:, :8]
    np.testing.assert_allclose(found, data.reward[:, None] + 0.5 * kept, rtol=1e-5)


def test_truncation_counts_over_members():
    values = torch.tensor([[[1.0, 2.0, 9.0]], [[3.0, 8.0, 7.0]]])
    assert QuantileCritic(Quantiles(quantiles=3, drop=1)).target_values(values).tolist() == [[1, 2, 3, 7]]
    assert QuantileCritic(Quantiles(quantiles=3, drop=0)).target_values(values).shape == (1, 6)
