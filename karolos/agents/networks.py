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
from .products import affine, product

EPSILON = 1e-5
"""Added to the variance in layer normalisation, as in torch.nn.LayerNorm."""


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
        self._exact = self._views(self.vector)
        self._rounded_vector = torch.zeros_like(self.vector, dtype=torch.bfloat16)
        self._rounded = self._views(self._rounded_vector)
        self._rounded_version = -1

    def _views(self, vector: Tensor) -> list[list[Tensor]]:
        """Weights and biases of each group, as views of a vector laid out as the parameters are."""
        table = vector.view(max(self.shape.members, 1), -1)
        shapes = self.shape.parameters()
        return [
            [table[group, columns].view(*lead, *shapes[name]) for name, columns in self._columns.items()]
            for group, lead in ((group, (-1,) if isinstance(group, slice) else ()) for group in self._groups)
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

    def _hidden_views(self, low: bool) -> list[list[Tensor]]:
        """The parameters in the type that hidden layers compute in; rounded anew when they have changed."""
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
        for rounded, exact in zip(self._hidden_views(low), self._exact, strict=True):
            layers: list[_Layer] = []
            h = x.expand(len(exact[0]), *x.shape) if exact[0].dim() == 3 else x
            for weight, bias in zip(rounded[:-2:2], rounded[1:-2:2], strict=True):
                layers.append(_hidden(h, weight, bias, self.shape.layer_norm))
                h = layers[-1].left
            h = h.float()
            outputs.append(affine(h, exact[-2], exact[-1], rectify=False))
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
        for_vector = torch.empty_like(self.vector) if parameters else None
        into = self._views(for_vector) if for_vector is not None else [[] for _ in self._groups]
        for_x: Tensor | None = None
        for group, (layers, rounded, exact) in enumerate(zip(tape, self._hidden_views(low), self._exact, strict=True)):
            g = gradient[group] if self.shape.members and gradient.dim() > exact[0].dim() else gradient
            *hidden, last = layers
            if parameters:
                _store(g, last.entered, into[group][-2:])
            # With one column out the product is an outer one, which both libraries are slow at.
            g = g * exact[-2] if exact[-2].shape[-2] == 1 else product(g, exact[-2])
            g = g.to(hidden[-1].left.dtype)
            for number in reversed(range(len(hidden))):
                g = _through(g, hidden[number])
                if parameters:
                    _store(g, hidden[number].entered, into[group][2 * number : 2 * number + 2])
                if number or inputs:
                    g = product(g, rounded[2 * number])
            if inputs:
                g = g.float() if g.dim() == 2 else g.float().sum(0)
                for_x = g if for_x is None else for_x.add_(g)
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


def _hidden(x: Tensor, weight: Tensor, bias: Tensor, layer_norm: bool) -> _Layer:
    if not layer_norm:
        return _Layer(x, affine(x, weight, bias, rectify=True), None)
    raw = affine(x, weight, bias, rectify=False)
    normal, mean, scale = torch.native_layer_norm(raw, raw.shape[-1:], None, None, EPSILON)
    return _Layer(x, normal.relu_(), (raw, mean, scale))


def _through(gradient: Tensor, layer: _Layer) -> Tensor:
    """From the gradient of what left a hidden layer to that of its affine map."""
    gradient = torch.ops.aten.threshold_backward(gradient, layer.left, 0)
    if layer.norm is None:
        return gradient
    raw, mean, scale = layer.norm
    back = torch.ops.aten.native_layer_norm_backward
    found: Tensor = back(gradient, raw, raw.shape[-1:], mean, scale, None, None, [True, False, False])[0]
    return found


def _store(gradient: Tensor, entered: Tensor, into: list[Tensor]) -> None:
    """Write the gradients of an affine map's weight and bias."""
    into[0].copy_(product(gradient.mT, entered))
    into[1].copy_(gradient.sum(-2, keepdim=True))


def _words(shapes: Mapping[str, tuple[int, ...]]) -> str:
    return ", ".join(f"{name} {'x'.join(map(str, dimensions))}" for name, dimensions in shapes.items())
