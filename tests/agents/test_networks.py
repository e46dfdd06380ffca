"""Networks against torch.nn, which is slower and known to be right."""

from itertools import pairwise

import pytest
import torch
from torch import Tensor, nn

from karolos.agents import layers as hidden_layers
from karolos.agents.networks import MLP, NetworkShape
from karolos.agents.optimisation import Adam
from karolos.errors import UsageError

SIZES = (20, 64, 48, 3)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def reference(network: MLP, member: int | None) -> nn.Sequential:
    """The same network (or one of its members) as torch.nn layers."""
    layers: list[nn.Module] = []
    for number, (before, after) in enumerate(pairwise(network.shape.sizes)):
        linear = nn.Linear(before, after)
        weight, bias = network.named[f"layer{number}.weight"], network.named[f"layer{number}.bias"]
        with torch.no_grad():
            linear.weight.copy_(weight if member is None else weight[member])
            linear.bias.copy_((bias if member is None else bias[member])[0])
        layers.append(linear)
        if number < len(network.shape.sizes) - 2:
            if network.shape.layer_norm:
                layers.append(nn.LayerNorm(after, elementwise_affine=False))
            layers.append(nn.ReLU())
    return nn.Sequential(*layers)


def flat_gradient(layers: nn.Sequential) -> Tensor:
    return torch.cat([parameter.grad.flatten() for parameter in layers.parameters() if parameter.grad is not None])


@pytest.mark.parametrize("layer_norm", [False, True])
@pytest.mark.parametrize("sizes", [SIZES, (7, 32, 32, 32, 1), (5, 17, 2), (70, 66, 72, 1)])
def test_stacked_members_equal_separate_networks_in_outputs_and_gradients(sizes, layer_norm):
    network = MLP(NetworkShape(sizes, members=2, layer_norm=layer_norm), generator(), "cpu")
    x = torch.randn((65, sizes[0]), generator=generator(1))
    pull = torch.randn((2, 65, sizes[-1]), generator=generator(2))
    outputs, tapes = network.forward(x)
    for_x = network.backward(pull, tapes, columns=slice(None))

    separate = [reference(network, member) for member in range(2)]
    plain = x.clone().requires_grad_()
    expected = torch.stack([layers(plain) for layers in separate])
    (expected * pull).sum().backward()
    torch.testing.assert_close(outputs, expected, rtol=1e-4, atol=1e-5)
    expected = torch.cat([flat_gradient(s) for s in separate])
    torch.testing.assert_close(network.gradient, expected, rtol=1e-3, atol=1e-4)
    assert plain.grad is not None
    torch.testing.assert_close(for_x, plain.grad, rtol=1e-3, atol=1e-4)

    network.gradient.zero_()
    _, tapes = network.forward(x)
    columns = network.backward(pull, tapes, parameters=False, columns=slice(2, 4))
    torch.testing.assert_close(columns, plain.grad[:, 2:4], rtol=1e-3, atol=1e-4)
    assert not network.gradient.any()


@pytest.mark.parametrize("layer_norm", [False, True])
@pytest.mark.parametrize("low", [False, True])
def test_some_rows_of_a_pass_have_the_gradient_of_a_pass_of_their_own(low, layer_norm):
    network = MLP(NetworkShape(SIZES, bfloat16=low, layer_norm=layer_norm), generator(), "cpu")
    x, pull = torch.randn((32, 20), generator=generator(1)), torch.randn((16, 3), generator=generator(2))
    outputs, tapes = network.forward(x)
    network.backward(pull, [tape.rows(16) for tape in tapes])
    found = network.gradient.clone()
    own, tapes = network.forward(x[16:])
    network.backward(pull, tapes)
    torch.testing.assert_close(outputs[16:], own)
    torch.testing.assert_close(found, network.gradient)


@pytest.mark.parametrize("low", [False, True])
def test_the_first_member_is_computed_alone_as_among_the_others(low):
    network = MLP(NetworkShape((20, 64, 48, 1), members=2, bfloat16=low), generator(), "cpu")
    x, pull = torch.randn((32, 20), generator=generator(1)), torch.zeros((2, 32, 1))
    pull[0] = torch.randn((32, 1), generator=generator(2))
    both, tapes = network.forward(x)
    expected = network.backward(pull, tapes, parameters=False, columns=slice(16, None))
    first, tapes = network.forward(x, members=1)
    assert torch.equal(first[0], both[0])
    assert torch.equal(network.backward(pull[:1], tapes, parameters=False, columns=slice(16, None)), expected)


@pytest.mark.parametrize("layer_norm", [False, True])
def test_bfloat16_stays_near_float32(layer_norm):
    low = MLP(NetworkShape(SIZES, members=2, bfloat16=True, layer_norm=layer_norm), generator(), "cpu")
    exact = MLP(NetworkShape(SIZES, members=2, layer_norm=layer_norm), generator(), "cpu")
    x = torch.randn((64, 20), generator=generator(1))
    outputs, by_inputs = [], []
    for network in (low, exact):
        y, tapes = network.forward(x)
        by_inputs.append(network.backward(torch.ones_like(y), tapes, columns=slice(None)).flatten())
        outputs.append(y)
    assert outputs[0].dtype == torch.float32
    torch.testing.assert_close(*outputs, rtol=0.05, atol=0.02)
    assert torch.cosine_similarity(low.gradient, exact.gradient, dim=0) > 0.99
    assert torch.cosine_similarity(*by_inputs, dim=0) > 0.99


def test_exact_outputs_do_not_depend_on_precision():
    low, exact = (MLP(NetworkShape(SIZES, bfloat16=low), generator(), "cpu") for low in (True, False))
    x = torch.randn((8, 20), generator=generator(1))
    assert torch.equal(low(x, exact=True), exact(x))


@pytest.mark.parametrize("plain", [False, True], ids=["ours", "of torch"])
def test_an_optimiser_step_reaches_the_bfloat16_weights(plain):
    network = MLP(NetworkShape(SIZES, bfloat16=True), generator(), "cpu")
    x = torch.randn((64, 20), generator=generator(1))
    before = network(x).square().mean()
    ours, theirs = Adam(network.vector, 0.01), torch.optim.Adam([network.vector], 0.01)
    for _ in range(20):
        y, tapes = network.forward(x)
        network.backward(y, tapes)
        network.vector.grad = network.gradient
        theirs.step() if plain else ours.step(network.gradient)
    assert network(x).square().mean() < 0.2 * before
    torch.testing.assert_close(network(x), network(x, exact=True), rtol=0.05, atol=0.02)
    fresh = MLP(network.shape, generator(1), "cpu")
    fresh.load_state(network.state())
    assert torch.equal(network(x), fresh(x))


def test_members_begin_different():
    network = MLP(NetworkShape(SIZES, members=2), generator(), "cpu")
    weight = network.named["layer0.weight"]
    assert not torch.equal(weight[0], weight[1])
    assert weight.abs().max() <= 20**-0.5


def test_state_of_another_shape_is_refused_with_both_shapes():
    with pytest.raises(UsageError, match=r"layer0\.weight 17x5.*layer0\.weight 64x20"):
        MLP(NetworkShape(SIZES), generator(), "cpu").load_state(
            MLP(NetworkShape((5, 17, 2)), generator(), "cpu").state()
        )


@pytest.mark.parametrize("members", [0, 2])
@pytest.mark.parametrize("layer_norm", [False, True])
def test_under_autograd_outputs_and_gradients_are_those_of_torch_nn(members, layer_norm):
    network = MLP(NetworkShape(SIZES, members=members, layer_norm=layer_norm), generator(), "cpu")
    network.vector.requires_grad_()
    layers = [reference(network, member if members else None) for member in range(max(members, 1))]
    x = torch.randn((16, 20), generator=generator(1), requires_grad=True)
    same = x.detach().clone().requires_grad_()
    outputs = network(torch.tanh(x)).square() + network(x)  # two passes in one graph
    expected = torch.stack([each(torch.tanh(same)).square() + each(same) for each in layers])
    outputs.sum().backward()
    expected.sum().backward()
    torch.testing.assert_close(outputs, expected if members else expected[0], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(network.vector.grad, torch.cat([flat_gradient(e) for e in layers]), rtol=1e-3, atol=1e-4)
    torch.testing.assert_close(x.grad, same.grad, rtol=1e-3, atol=1e-4)


def test_parameters_that_change_before_the_backward_pass_are_an_error():
    network = MLP(NetworkShape(SIZES), generator(), "cpu")
    network.vector.requires_grad_()
    loss = network(torch.ones(4, 20)).sum()
    with torch.no_grad():
        network.vector.add_(1)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


def test_layer_normalisation_is_that_of_torch_and_keeps_nan():
    rows, gradient = torch.randn((2, 5, 130), generator=torch.Generator().manual_seed(0)).add(3)
    rows[1, 7] = torch.nan
    raw = rows.clone().requires_grad_()
    plain_rows = torch.nn.functional.layer_norm(raw, raw.shape[-1:], eps=hidden_layers.LAYER_NORM_EPSILON)
    [expected] = torch.autograd.grad(plain_rows, raw, gradient)
    rectified, means, scales = hidden_layers.normalised(rows)
    torch.testing.assert_close(rectified, plain_rows.detach().relu(), equal_nan=True)
    found = hidden_layers.normalised_backward(gradient.clone(), rows, means, scales)
    torch.testing.assert_close(found, expected, equal_nan=True)
