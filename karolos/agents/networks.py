"""Multi-layer perceptrons whose parameters are one vector: one network, or several of the same shape.

With one vector a step of an optimiser, a step of a target network and a checkpoint are one operation each. Agents of
karolos call `forward` and `backward`; a plugin can use a network under autograd instead.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..core import Deployed, JointLayers, Layer, State
from ..errors import UsageError
from . import layers
from .layers import Affine, Tape


@dataclass(frozen=True)
class NetworkShape:
    """Layers and options of a network.

    Args:
        sizes: input columns, units of each hidden layer, output columns.
        members: number of networks of this shape; 0: one network, without an axis for it.
        layer_norm: normalise each hidden layer before its rectifier, without a learned gain.
        bfloat16: compute hidden layers in bfloat16. The last layer is float32: near 16 bfloat16 has steps of 1/8.
    """

    sizes: tuple[int, ...]
    members: int = 0
    layer_norm: bool = False
    bfloat16: bool = False

    def parameters(self) -> dict[str, tuple[int, int]]:
        """Name and shape of each parameter of one member, in their order in the vector."""
        shapes: dict[str, tuple[int, int]] = {}
        for number, (before, after) in enumerate(pairwise(self.sizes)):
            shapes[f"layer{number}.weight"] = (after, before)
            shapes[f"layer{number}.bias"] = (1, after)
        return shapes


class MLP:
    """Affine layers with rectifiers between them.

    Members are computed one after the other: on a CPU two products of half the size take as long as one, and the
    activations stay in the cache.

    Under autograd call `vector.requires_grad_()`, give `[vector]` to an optimiser of torch.optim and call the network.

    Args:
        generator: samples the weights, on the CPU: uniform in +- 1 / sqrt(input columns), as torch.nn.Linear does.
    """

    def __init__(self, shape: NetworkShape, generator: torch.Generator, device: str) -> None:
        self.shape = shape
        members, sizes = max(shape.members, 1), [math.prod(size) for size in shape.parameters().values()]
        self.vector = torch.zeros(members * sum(sizes), device=device)
        """All parameters, one member after the other. Change it in place."""
        self.gradient = torch.zeros_like(self.vector)
        """Result of the latest `backward`."""
        self._table, gradients = self.vector.view(members, -1), self.gradient.view(members, -1)
        for number, fan_in in enumerate(shape.sizes[:-1]):
            for name in (f"layer{number}.weight", f"layer{number}.bias"):
                part = self._views(self._table)[name]
                part.copy_((torch.rand(part.shape, generator=generator) * 2 - 1) / fan_in**0.5)
        hidden = sum(sizes[:-2]) if shape.bfloat16 else 0
        self._rounded = torch.zeros((members, hidden), dtype=torch.bfloat16, device=device)
        """The hidden layers' parameters in bfloat16."""
        self._rounded_version = -1
        self._rounded_gradient = torch.zeros_like(self._rounded)
        """The gradient by the hidden layers' parameters in bfloat16, before it is copied to `gradient`."""
        self._hidden_gradient = gradients[:, :hidden]
        self._layers, self._gradients = self._layers_in(self._table), self._layers_in(gradients)
        self._rounded_layers = self._with_last(self._rounded, self._layers)
        self._rounded_gradients = self._with_last(self._rounded_gradient, self._gradients)

    def _views(self, memory: Tensor) -> dict[str, Tensor]:
        """Each parameter, or each of the hidden layers, as a view (members, ...) of memory (members, numbers)."""
        shapes = self.shape.parameters()
        if memory.dtype == torch.bfloat16:
            shapes = dict(list(shapes.items())[:-2]) if memory.numel() else {}
        parts = memory.split_with_sizes([math.prod(shape) for shape in shapes.values()], 1)
        return {name: part.view(-1, *shapes[name]) for name, part in zip(shapes, parts, strict=True)}

    def _layers_in(self, memory: Tensor) -> list[list[Affine]]:
        """The layers of each member, as views of memory."""
        views = list(self._views(memory).values())
        return [
            [Affine(weight[member], bias[member, 0]) for weight, bias in zip(views[::2], views[1::2], strict=True)]
            for member in range(len(memory))
        ]

    def _with_last(self, rounded: Tensor, exact: list[list[Affine]]) -> list[list[Affine]]:
        """The layers of each member: hidden ones as views of `rounded`, the last one of `exact`."""
        return [hidden + layers_[-1:] for hidden, layers_ in zip(self._layers_in(rounded), exact, strict=True)]

    @property
    def named(self) -> dict[str, Tensor]:
        """Each parameter, as a view: (members, ...), or without that axis."""
        views = self._views(self._table)
        return views if self.shape.members else {name: view[0] for name, view in views.items()}

    def __call__(self, x: Tensor, *, exact: bool = False) -> Tensor:
        """(n, in) -> (n, out), or (members, n, out), in float32 if `exact`.

        Differentiable by x and by `vector` where they require it.
        """
        if torch.is_grad_enabled() and (x.requires_grad or self.vector.requires_grad):
            outputs: Tensor = _Autograd.apply(x, self.vector, self, exact)  # type: ignore[no-untyped-call]
            return outputs
        return self.forward(x, exact=exact)[0]

    def _computing(self, *, bfloat16: bool) -> list[list[Affine]]:
        """The layers of each member in the type they compute in, rounded again if `vector` has changed."""
        if not bfloat16:
            return self._layers
        if self._rounded_version != self.vector._version:
            self._rounded.copy_(self._table[:, : self._rounded.shape[1]])
            self._rounded_version = self.vector._version
        return self._rounded_layers

    def forward(self, x: Tensor, *, exact: bool = False, members: int | None = None) -> tuple[Tensor, list[Tape]]:
        """Outputs as of a call, and a tape of each member, for `backward`. With `members`: only of the first ones."""
        bfloat16 = self.shape.bfloat16 and not exact
        if bfloat16:
            x = x.bfloat16()
        passes = [
            layers.forward(x, member, layer_norm=self.shape.layer_norm)
            for member in self._computing(bfloat16=bfloat16)[:members]
        ]
        outputs = torch.stack([output for output, _ in passes]) if self.shape.members else passes[0][0]
        return outputs, [tape for _, tape in passes]

    def backward(
        self, gradient: Tensor, tapes: Sequence[Tape], *, parameters: bool = True, columns: slice | None = None
    ) -> Tensor | None:
        """Compute the gradient by the parameters, into `gradient`, and by the inputs from the gradient by the outputs.

        Args:
            gradient: of the outputs' shape.
            tapes: of `forward`; the parameters must not have changed since.
            parameters: False: leave `gradient` as it is. True needs the tapes of all members.
            columns: input columns whose gradient is wanted.

        Returns:
            (n, columns), summed over the members; None if `columns` is None.
        """
        bfloat16 = tapes[0].bfloat16
        total: Tensor | None = None
        computing = self._computing(bfloat16=bfloat16)
        out = self._rounded_gradients if bfloat16 else self._gradients
        for member, tape in enumerate(tapes):
            by_input = layers.backward(
                gradient[member] if self.shape.members else gradient,
                tape,
                computing[member],
                out=out[member] if parameters else None,
                columns=columns,
            )
            total = by_input if total is None or by_input is None else total.add_(by_input)
        if parameters and bfloat16:
            self._hidden_gradient.copy_(self._rounded_gradient)
        return total

    def copy(self) -> MLP:
        """A network with equal parameters in a vector of its own: a target network."""
        other = type(self)(self.shape, torch.Generator(), str(self.vector.device))
        other.vector.copy_(self.vector.detach())
        return other

    def follow(self, other: MLP, tau: float) -> None:
        """Polyak averaging: parameters = (1 - tau) parameters + tau other's parameters."""
        self.vector.lerp_(other.vector, tau)

    def arrays(self, columns: slice) -> tuple[list[Layer], JointLayers | None]:
        """Copies of the layers, without members, for a `Deployed` with these columns of the outputs."""
        *hidden, last = (Layer(array_of(one.weight), array_of(one.bias)) for one in self._layers[0])
        return [*hidden, Layer(last.weight[columns], last.bias[columns])], None

    def adopt(self, policy: Deployed) -> None:
        """Take the layers of an exported policy. Outputs that only exploration needs stay as they are."""
        for own, layer in zip(self._layers[0], policy.layers, strict=True):
            take(own, layer)

    def state(self) -> State:
        return {name: view.detach().clone() for name, view in self.named.items()}

    @torch.no_grad()
    def load_state(self, state: State) -> None:
        """Load a state. Raises UsageError if it belongs to a network of another shape."""
        own = {name: tuple(view.shape) for name, view in self.named.items()}
        stored = {name: tuple(view.shape) for name, view in state.items()}
        if stored != own:
            raise UsageError(
                f"the stored network has parameters {_words(stored)}, and this one {_words(own)}",
                setting="agent",
                hint="load it with the spec it was trained with",
            )
        for name, view in self.named.items():
            view.copy_(torch.as_tensor(state[name]))


class _Autograd(torch.autograd.Function):
    """`MLP.forward` and `MLP.backward` as one differentiable operation of inputs and parameter vector."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, vector: Tensor, network: MLP, exact: bool) -> Tensor:
        outputs, ctx.tapes = network.forward(x, exact=exact)
        ctx.network = network
        ctx.save_for_backward(vector)  # torch raises an error if it is changed before the backward pass
        return outputs

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None, None, None]:
        _ = ctx.saved_tensors
        by_input, by_vector, *_ = ctx.needs_input_grad
        columns = slice(None) if by_input else None
        found = ctx.network.backward(gradient, ctx.tapes, parameters=by_vector, columns=columns)
        return found, ctx.network.gradient.clone() if by_vector else None, None, None


def array_of(part: Tensor) -> NDArray[Any]:
    """A copy on the CPU."""
    return part.detach().cpu().numpy().copy()


def take(own: Affine, layer: Layer) -> None:
    """Copy a layer to the first outputs of another one."""
    own.weight[: len(layer.weight)] = torch.from_numpy(layer.weight)
    own.bias[: layer.bias.size] = torch.from_numpy(layer.bias)


def _words(shapes: Mapping[str, tuple[int, ...]]) -> str:
    return ", ".join(f"{name} {'x'.join(map(str, dimensions))}" for name, dimensions in shapes.items())
