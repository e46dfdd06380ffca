"""The network that treats joints alike, against its formula under autograd."""

import numpy as np
import pytest
import torch
from support.parts import batch, jointed, make, signature
from torch import Tensor
from torch.nn.functional import layer_norm as normalised

from karolos.agents.joint_network import JointNetwork, JointShape
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.core import Field
from karolos.errors import UsageError

JOINTS, OTHERS, HIDDEN = ((0, 3, 8), (1, 4, 9), (2, 5, 10)), (6, 7, 11, 12), (6, 8, 7)
POLICY = JointShape((13, *HIDDEN, 8), joints=JOINTS, each=((0, 4), (1, 5), (2, 6)))
"""Two outputs for each of three joints, and two for something else."""
CRITICS = JointShape((13, *HIDDEN, 2), members=2, layer_norm=True, joints=JOINTS, each=((), (), ()))


def formula(shape: JointShape, p: dict[str, Tensor], x: Tensor) -> Tensor:
    """What one member gives for x, joint after joint."""
    h = HIDDEN[0]
    others = x[:, list(OTHERS)]
    rows = [x[:, list(columns)] @ p["joint.weight"].T for columns in shape.joints]
    to_all = others @ p["others.weight"].T
    bias = p["joint.bias"][0]
    rectified = sum((row[:, :h] + to_all[:, :h] + bias[:h]).relu() for row in rows)
    products = sum(
        (row[:, h : 2 * h] + to_all[:, h:] + bias[h : 2 * h]) * (row[:, 2 * h : 3 * h] + bias[2 * h :]) for row in rows
    )
    y = torch.cat((torch.cat((torch.as_tensor(rectified), torch.as_tensor(products)), 1) / 3**0.5, others), 1)
    last = len(HIDDEN) - 1
    for number in range(last + 1):
        y = y @ p[f"layer{number}.weight"].T + p[f"layer{number}.bias"]
        if number < last:
            y = (normalised(y, y.shape[1:]) if shape.layer_norm else y).relu()
    if "each.weight" not in p:
        return y
    outputs = torch.zeros(len(x), 8)
    for row, columns in zip(rows, shape.each, strict=True):
        hidden = torch.cat(((row[:, 3 * h : 4 * h] + y[:, :h]).relu(), row[:, 4 * h :] * y[:, h : 2 * h]), 1)
        outputs[:, list(columns)] = hidden @ p["each.weight"].T + p["each.bias"]
    outputs[:, [3, 7]] = y[:, 2 * h :]
    return outputs


@pytest.mark.parametrize("shape", [POLICY, CRITICS])
def test_outputs_and_gradients_are_those_of_the_formula(shape):
    network = JointNetwork(shape, torch.Generator().manual_seed(0), "cpu")
    x = torch.randn((20, 13), generator=torch.Generator().manual_seed(1))
    outputs, tapes = network.forward(x)
    pull = torch.randn(outputs.shape, generator=torch.Generator().manual_seed(2))
    by_input = network.backward(pull, tapes, columns=slice(2, 12))

    leaf, parameters = x.clone().requires_grad_(), network.vector.clone().requires_grad_()
    views, members = network._views(parameters.view(max(shape.members, 1), -1)), range(max(shape.members, 1))
    expected = torch.stack([formula(shape, {n: view[m] for n, view in views.items()}, leaf) for m in members])
    expected = expected if shape.members else expected[0]
    by_leaf, by_parameters = torch.autograd.grad((expected * pull).sum(), (leaf, parameters))
    torch.testing.assert_close(outputs, expected)
    torch.testing.assert_close(network.gradient, by_parameters, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(by_input, by_leaf[:, 2:12], rtol=1e-4, atol=1e-5)


def test_a_tape_of_some_rows_gives_their_gradient():
    network = JointNetwork(POLICY, torch.Generator().manual_seed(0), "cpu")
    x = torch.randn((20, 13), generator=torch.Generator().manual_seed(1))
    outputs, [tape] = network.forward(x)
    network.backward(torch.ones_like(outputs[12:]), [tape.rows(12)])
    found = network.gradient.clone()
    outputs, tapes = network.forward(x[12:])
    network.backward(torch.ones_like(outputs), tapes)
    torch.testing.assert_close(found, network.gradient)


def test_joints_that_change_places_change_their_outputs_and_no_value():
    x = torch.randn((5, 13), generator=torch.Generator().manual_seed(1))
    swapped = x.clone()
    swapped[:, [*JOINTS[0], *JOINTS[2]]] = x[:, [*JOINTS[2], *JOINTS[0]]]
    policy, critics = (JointNetwork(shape, torch.Generator().manual_seed(0), "cpu") for shape in (POLICY, CRITICS))
    torch.testing.assert_close(policy(swapped), policy(x)[:, [2, 1, 0, 3, 6, 5, 4, 7]])
    torch.testing.assert_close(critics(swapped), critics(x))


def test_joints_that_nobody_describes_are_refused():
    with pytest.raises(UsageError, match="do not describe joints"):
        make(SAC, signature(), per_joint=True)


@pytest.mark.parametrize("kind", [SAC, TD3])
def test_an_agent_acts_alike_if_joints_change_places_and_its_state_is_its_own(kind):
    of = jointed((), Field("grip", 1))
    agent = make(kind, of, per_joint=True, hidden=(16, 24, 24))
    for update in range(4):
        agent.learn(batch(32, of, seed=update))
    data = batch(5, of, seed=9)
    swapped = data.observation[:, [0, 1, 2, 3, 8, 9, 6, 7, 4, 5, 12, 11, 10]]
    actions = agent.act(data.observation, data.desired_goal, explore=False)
    np.testing.assert_allclose(
        agent.act(swapped, data.desired_goal, explore=False), actions[:, [2, 1, 0, 3]], atol=1e-5
    )
    other = make(kind, of, seed=1, per_joint=True, hidden=(16, 24, 24))
    other.load_state(agent.state())
    np.testing.assert_array_equal(other.act(data.observation, data.desired_goal, explore=False), actions)
    assert other.learn(data).keys() == agent.learn(data).keys()
    np.testing.assert_array_equal(other.critic.vector.numpy(), agent.critic.vector.numpy())
