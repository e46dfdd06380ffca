"""Multi-layer perceptrons whose parameters lie in one vector, alone or several of one shape side by side.

At the size of robot-task networks an update is made of hundreds of operations of a few microseconds each. Hence one
vector for all parameters (an optimiser step, a step of a target network or a checkpoint is one operation) and one node
of the autograd graph per network, with the chain rule written down.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core import State
from ..errors import UsageError
from .products import Affine, affine, affine_map, product, product_into

EPSILON = 1e-5
"""Added to the variance in layer normalisation, as in torch.nn.LayerNorm."""
_RECTIFIER_BACK = torch.ops.aten.threshold_backward.grad_input
_NORM_BACK = torch.ops.aten.native_layer_norm_backward.default


@dataclass(frozen=True)
class Shape:
    """What a network looks like.

    Args:
        sizes: columns in, hidden units of each layer, columns out.
        members: networks of this shape side by side; 0: one, and no axis for it.
        layer_norm: normalise each hidden layer before its rectifier (without learned gain: the next layer has one).
        low: compute hidden layers in bfloat16. The last layer is always float32: bfloat16 tells a value of 16 from
            16.1, but not from 16.05.
    """

    sizes: tuple[int, ...]
    members: int = 0
    layer_norm: bool = False
    low: bool = False

    def parameters(self) -> dict[str, tuple[int, int]]:
        """Name and shape of each parameter of one member, in their order in the vector."""
        shapes: dict[str, tuple[int, int]] = {}
        for layer, (before, after) in enumerate(pairwise(self.sizes)):
            shapes[f"layer{layer}.weight"] = (after, before)
            shapes[f"layer{layer}.bias"] = (1, after)
        return shapes


class _Layer(NamedTuple):
    """What the way back needs of a hidden layer: what entered, what left, and how it was normalised."""

    entered: Tensor
    left: Tensor
    norm: tuple[Tensor, Tensor, Tensor] | None


class MLP:
    """Affine layers with rectifiers between them.

    Several members are computed as one product per layer on a GPU, where launches cost. On a CPU they are computed one
    after the other: two products of half the size take as long as one, and half-size activations stay in the cache.

    Args:
        shape: layers, members, options.
        generator: draws the weights, on the CPU: uniform in +- 1 / sqrt(columns in), as torch.nn.Linear does.
        device: where the parameters live.
    """

    def __init__(self, shape: Shape, generator: torch.Generator, device: str) -> None:
        self.shape = shape
        rows = max(shape.members, 1)
        self._shapes = list(shape.parameters().values())
        self._sizes = [math.prod(dimensions) for dimensions in self._shapes]
        self._columns: dict[str, slice] = {}
        start = 0
        for name, dimensions in shape.parameters().items():
            self._columns[name] = slice(start, start + math.prod(dimensions))
            start += math.prod(dimensions)
        self.vector = torch.zeros(rows * start, device=device)
        """All parameters, one member after the other. Change it in place; gradients are those of `leaf`."""
        self.leaf = self.vector.detach().requires_grad_()
        """The same memory, for autograd and the optimiser."""
        table = self.vector.view(rows, start)
        for layer, fan_in in enumerate(shape.sizes[:-1]):
            for name in (f"layer{layer}.weight", f"layer{layer}.bias"):
                part = table[:, self._columns[name]]
                part.copy_((torch.rand(part.shape, generator=generator) * 2 - 1) / fan_in**0.5)
        stacked = shape.members > 0 and self.vector.device.type != "cpu"
        self._groups: list[slice | int] = [slice(0, rows)] if stacked else list(range(rows))
        """Members that are computed together."""
        self._exact = self._maps(self.vector)
        self._rounded_vector = torch.zeros_like(self.vector, dtype=torch.bfloat16)
        self._rounded = self._maps(self._rounded_vector)
        self._rounded_version = -1
        self._low_gradient = torch.zeros_like(self._rounded_vector)
        """Where a gradient is put together in bfloat16, before a vector of its own takes it in float32."""
        self._low_gradients = self._views(self._low_gradient)

    def _views(self, vector: Tensor) -> list[list[Tensor]]:
        """Weights and biases of each group, as views of a vector laid out as the parameters are."""
        table = vector.view(max(self.shape.members, 1), -1)
        views = []
        for group in self._groups:
            lead = (-1,) if isinstance(group, slice) else ()
            parts = table[group].split_with_sizes(self._sizes, -1)  # one call for all: indexing costs as much for each
            views.append([part.view(*lead, *shape) for part, shape in zip(parts, self._shapes, strict=True)])
        return views

    def _last_views(self, vector: Tensor) -> list[list[Tensor]]:
        """Weight and bias of each group's last layer, as in `_views`."""
        table = vector.view(max(self.shape.members, 1), -1)
        first = table.shape[1] - self._sizes[-2] - self._sizes[-1]
        views = []
        for group in self._groups:
            lead = (-1,) if isinstance(group, slice) else ()
            parts = table[group][..., first:].split_with_sizes(self._sizes[-2:], -1)
            views.append([part.view(*lead, *shape) for part, shape in zip(parts, self._shapes[-2:], strict=True)])
        return views

    def _maps(self, vector: Tensor) -> list[list[Affine]]:
        """The layers of each group, with parameters from a vector laid out as the parameters are."""
        return [
            [affine_map(*pair) for pair in zip(views[::2], views[1::2], strict=True)] for views in self._views(vector)
        ]

    @property
    def named(self) -> dict[str, Tensor]:
        """Each parameter, as a view: (members, ...), or without that axis."""
        table = self.vector.view(max(self.shape.members, 1), -1)
        shapes = self.shape.parameters()
        views = {name: table[:, columns].view(-1, *shapes[name]) for name, columns in self._columns.items()}
        return views if self.shape.members else {name: view[0] for name, view in views.items()}

    def __call__(self, x: Tensor, *, learn: bool = False, exact: bool = False) -> Tensor:
        """(n, in) -> (n, out), or (members, n, out).

        Args:
            x: inputs, the same for all members.
            learn: let gradients flow to `leaf`; to the inputs they always do.
            exact: compute in float32 whatever the shape says; only without gradients.
        """
        if torch.is_grad_enabled():
            found: Tensor = _Pass.apply(x, self.leaf if learn else self.vector, self)  # type: ignore[no-untyped-call]
            return found
        return self._forward(x, low=self.shape.low and not exact)[0]

    def _hidden_maps(self, low: bool) -> list[list[Affine]]:
        """The layers with parameters in the type that hidden layers compute in; rounded anew when they have changed."""
        if not low:
            return self._exact
        if self._rounded_version != self.vector._version:
            self._rounded_vector.copy_(self.vector)
            self._rounded_version = self.vector._version
        return self._rounded

    def _forward(self, x: Tensor, *, low: bool) -> tuple[Tensor, list[list[_Layer]]]:
        """Outputs, and what `_backward` needs: the layers of each group."""
        if low:
            x = x.bfloat16()
        outputs, tape = [], []
        for rounded, exact in zip(self._hidden_maps(low), self._exact, strict=True):
            layers: list[_Layer] = []
            weight = exact[0].weight
            h = x.expand(len(weight), *x.shape) if weight.dim() == 3 else x
            for hidden in rounded[:-1]:
                layers.append(_hidden(h, hidden, self.shape.layer_norm))
                h = layers[-1].left
            h = h.float()
            outputs.append(affine(h, exact[-1], rectify=False))
            layers.append(_Layer(h, h, None))
            tape.append(layers)
        if not self.shape.members or outputs[0].dim() == 3:
            return outputs[0], tape
        return torch.stack(outputs), tape

    def _backward(
        self, gradient: Tensor, tape: list[list[_Layer]], *, inputs: bool, parameters: bool
    ) -> tuple[Tensor | None, Tensor | None]:
        """Gradients for the inputs and for the vector, from those of the outputs."""
        low = tape[0][0].entered.dtype == torch.bfloat16
        into: list[list[Tensor]] = [[] for _ in self._groups]
        for_vector: Tensor | None = None
        if parameters and not low:
            for_vector = torch.empty_like(self.vector)
            into = self._views(for_vector)
        elif parameters:
            into = self._low_gradients
        last_ones: list[tuple[Tensor, Tensor]] = []
        """Of each group's last layer: the outputs' gradient, and what entered."""
        for_x: Tensor | None = None
        for group, (layers, rounded, exact) in enumerate(zip(tape, self._hidden_maps(low), self._exact, strict=True)):
            weight = exact[-1].weight
            g = gradient[group] if self.shape.members and gradient.dim() > weight.dim() else gradient
            *hidden, last = layers
            last_ones.append((g, last.entered))
            # With one column out the product is an outer one, which both libraries are slow at.
            g = g * weight if weight.shape[-2] == 1 else product(g, weight)
            g = g.to(hidden[-1].left.dtype)
            for number in reversed(range(len(hidden))):
                g = _through(g, hidden[number])
                if parameters:
                    _store(g, hidden[number].entered, into[group][2 * number : 2 * number + 2])
                if number or inputs:
                    g = product(g, rounded[number].weight)
            if inputs:
                g = g.float() if g.dim() == 2 else g.float().sum(0)
                for_x = g if for_x is None else for_x.add_(g)
        if parameters:
            if for_vector is None:
                for_vector = self._low_gradient.float()
            for (g, entered), views in zip(last_ones, self._last_views(for_vector), strict=True):
                _store(g, entered, views)
        return for_x, for_vector

    def copy(self) -> MLP:
        """A network with the same parameters in a vector of its own: a target network."""
        other = MLP(self.shape, torch.Generator(), str(self.vector.device))
        other.vector.copy_(self.vector)
        return other

    def follow(self, other: MLP, share: float) -> None:
        """Move this share of the way to the other network's parameters (Polyak averaging)."""
        self.vector.lerp_(other.vector, share)

    def state(self) -> State:
        return {name: view.clone() for name, view in self.named.items()}

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of a network of another shape."""
        mine = {name: tuple(view.shape) for name, view in self.named.items()}
        found = {name: tuple(view.shape) for name, view in state.items()}
        if found != mine:
            raise UsageError(
                f"the stored network has parameters {_words(found)}, and this one {_words(mine)}",
                where="agent",
                hint="load it with the spec it was trained with",
            )
        for name, view in self.named.items():
            view.copy_(torch.as_tensor(state[name]))


class _Pass(torch.autograd.Function):
    """One network as one node of the graph."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, vector: Tensor, network: MLP) -> Tensor:  # noqa: ARG004 (asks for its gradient)
        outputs, ctx.tape = network._forward(x, low=network.shape.low)
        ctx.network = network
        return outputs

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        inputs, parameters, _ = ctx.needs_input_grad
        return *ctx.network._backward(gradient, ctx.tape, inputs=inputs, parameters=parameters), None


def _hidden(x: Tensor, layer: Affine, layer_norm: bool) -> _Layer:
    if not layer_norm:
        return _Layer(x, affine(x, layer, rectify=True), None)
    raw = affine(x, layer, rectify=False)
    normal, mean, scale = torch.native_layer_norm(raw, raw.shape[-1:], None, None, EPSILON)
    return _Layer(x, normal.relu_(), (raw, mean, scale))


def _through(gradient: Tensor, layer: _Layer) -> Tensor:
    """From the gradient of what left a hidden layer, which is overwritten, to that of its affine map."""
    _RECTIFIER_BACK(gradient, layer.left, 0, grad_input=gradient)
    if layer.norm is None:
        return gradient
    raw, mean, scale = layer.norm
    found: Tensor = _NORM_BACK(gradient, raw, raw.shape[-1:], mean, scale, None, None, [True, False, False])[0]
    return found


def _store(gradient: Tensor, entered: Tensor, into: list[Tensor]) -> None:
    """Write the gradients of an affine map's weight and bias."""
    product_into(gradient.mT, entered, into[0])
    torch.sum(gradient, -2, keepdim=True, out=into[1])


def _words(shapes: Mapping[str, tuple[int, ...]]) -> str:
    return ", ".join(f"{name} {'x'.join(map(str, dimensions))}" for name, dimensions in shapes.items())
