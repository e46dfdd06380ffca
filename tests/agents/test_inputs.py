"""Running statistics, and inputs normalised by them."""

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from karolos.agents.inputs import INPUT_CLIP, SMALLEST_SPREAD, Normaliser, tensor_batch
from karolos.agents.sac import SAC
from karolos.core import Batch, Field, Layout, Signature
from karolos.core.seeding import SeedTree

NUMBERS = st.floats(-1000, 1000, width=32)


@given(
    batches=st.lists(hnp.arrays(np.float32, st.tuples(st.integers(1, 20), st.just(3)), elements=NUMBERS), min_size=1)
)
def test_statistics_over_batches_equal_those_over_all_rows(batches):
    normaliser = Normaliser(3, "cpu")
    for rows in batches:
        normaliser.update(torch.from_numpy(rows))
    together = np.concatenate(batches).astype(np.float64)
    np.testing.assert_allclose(normaliser.mean.numpy(), together.mean(0), rtol=1e-6, atol=1e-6)
    expected = np.maximum(together.std(0), SMALLEST_SPREAD)
    np.testing.assert_allclose(normaliser.spread.numpy(), expected, rtol=1e-4, atol=1e-4)


def test_goals_enter_as_what_is_missing_where_what_is_achieved_is_observed():
    achieved, seen = Layout((Field("place", 2), Field("held", 1))), Layout((Field("speed", 1), Field("place", 2)))
    signature = Signature(seen, Layout((Field("move", 1),)), 5, achieved_goal=achieved, desired_goal=achieved)
    agent = SAC(SAC.Settings(fine_goal=5), signature, SeedTree(0))
    observation, goal = np.float32([[7, 1, 2]]), np.float32([[5, 5, 9]])
    assert agent.unscaled(observation, goal).tolist() == [[7, 1, 2, 5, 5, 9, 4, 3]], "held is not observed"
    zero = np.zeros(1, np.float32)
    batch = Batch(observation, goal, zero[:, None], zero, observation + 1, zero, zero, zero, np.zeros(1, np.int64))
    inputs = tensor_batch(batch, agent.normaliser, torch.device("cpu"), observed_goal=agent.missing)
    assert torch.equal(agent.network_input(observation, goal), inputs.input)
    fine = torch.tanh(torch.tensor([[4.0, 3.0]]) * 5 / agent.normaliser.spread[-2:].float())
    torch.testing.assert_close(inputs.input[:, -2:], fine)


def test_inputs_pass_unchanged_before_the_first_update():
    rows = torch.tensor([[0.5, -2.0, 4.0]])
    assert torch.equal(Normaliser(3, "cpu")(rows), rows)
    fresh = Normaliser(3, "cpu", missing=slice(2, 3), fine=5.0)
    loaded = Normaliser(3, "cpu", missing=slice(2, 3), fine=5.0)
    loaded.load_state(fresh.state())
    assert torch.equal(loaded(rows), fresh(rows)), "also in an agent that resumes before it"


def test_outliers_are_clipped_and_columns_that_stand_still_not_blown_up():
    normaliser = Normaliser(2, "cpu")
    normaliser.update(torch.tensor([[0.0, 3.0], [1.0, 3.0]]))
    normal = normaliser(torch.tensor([[1e6, 3.001], [-1e6, 3.0]]))
    torch.testing.assert_close(normal, torch.tensor([[INPUT_CLIP, 0.1], [-INPUT_CLIP, 0.0]]), atol=1e-4, rtol=0)
