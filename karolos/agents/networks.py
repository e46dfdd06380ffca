"""Multi-layer perceptrons whose parameters are one vector, alone or several of one shape side by side.

An update of networks of this size is hundreds of operations of a few microseconds each. With one vector a step of an
optimiser, a step of a target network and a checkpoint are one operation each. Agents of karolos call `forward` and
`backward`; a plugin can use a network under autograd instead.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..core import State
from ..core.deployed import Deployed, Layer, Output
from ..errors import UsageError
from . import backprop
from .backprop import EPSILON, Tape
from .matmul import Affine, affine_map
from .normaliser import Normaliser
from .tensors import to_array


@dataclass(frozen=True)
class Shape:
    """Layers and options of a network.

    Args:
        sizes: input columns, units of each hidden layer, output columns.
        members: networks of this shape side by side; 0: one, without an axis for it.
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
        for layer, (before, after) in enumerate(pairwise(self.sizes)):
            shapes[f"layer{layer}.weight"] = (after, before)
            shapes[f"layer{layer}.bias"] = (1, after)
        return shapes


class MLP:
    """Affine layers with rectifiers between them.

    A GPU computes all members in one product per layer. A CPU computes them one after the other: two products of half
    the size take as long as one, and the activations stay in the cache.

    Under autograd call `vector.requires_grad_()`, give `[vector]` to an optimiser of torch.optim and call the network.

    Args:
        shape: layers, members, options.
        generator: draws the weights, on the CPU: uniform in +- 1 / sqrt(input columns), as torch.nn.Linear does.
        device: where the parameters live.
    """

    def __init__(self, shape: Shape, generator: torch.Generator, device: str) -> None:
        self.shape = shape
        self._members = max(shape.members, 1)
        self._shapes = list(shape.parameters().values())
        size = sum(map(math.prod, self._shapes))
        self.vector = torch.zeros(self._members * size, device=device)
        """All parameters, one member after the other. Change it in place."""
        self.gradient = torch.zeros_like(self.vector)
        """Result of the latest `backward`."""
        for layer, fan_in in enumerate(shape.sizes[:-1]):
            for name in (f"layer{layer}.weight", f"layer{layer}.bias"):
                part = self._table_views(self.vector)[name]
                part.copy_((torch.rand(part.shape, generator=generator) * 2 - 1) / fan_in**0.5)
        last = math.prod(self._shapes[-2]) + math.prod(self._shapes[-1])
        self._rounded = torch.zeros(
            (self._members, size - last if shape.bfloat16 else 0), dtype=torch.bfloat16, device=device
        )
        """The hidden layers' parameters in bfloat16."""
        self._rounded_version = -1
        self._rounded_gradient = torch.zeros_like(self._rounded)
        """The gradient by the hidden layers' parameters in bfloat16, before it is copied to `gradient`."""
        self._scratch = backprop.Scratch()
        self._group(stacked=shape.members > 0 and self.vector.device.type != "cpu")

    def _group(self, *, stacked: bool) -> None:
        """Choose which members are computed together, and make the views of each group's parameters."""
        self._groups: list[slice | int] = [slice(0, self._members)] if stacked else list(range(self._members))
        self._layers = self._affine_maps(self.vector)
        self._gradients = self._views(self.gradient)
        self._rounded_layers = self._affine_maps(self._rounded)
        rounded = self._views(self._rounded_gradient)
        self._rounded_gradients = [hidden + all_[-2:] for hidden, all_ in zip(rounded, self._gradients, strict=True)]

    def _views(self, memory: Tensor) -> list[list[Tensor]]:
        """Weights and biases of each group, as views of memory laid out like all parameters, or the hidden ones."""
        table = memory.view(self._members, -1)
        shapes = self._shapes if memory.dim() == 1 else self._shapes[:-2] if memory.numel() else []
        views = []
        for group in self._groups:
            lead = (-1,) if isinstance(group, slice) else ()
            parts = table[group].split_with_sizes([math.prod(shape) for shape in shapes], -1)
            views.append([part.view(*lead, *shape) for part, shape in zip(parts, shapes, strict=True)])
        return views

    def _affine_maps(self, memory: Tensor) -> list[list[Affine]]:
        return [
            [affine_map(*pair) for pair in zip(views[::2], views[1::2], strict=True)] for views in self._views(memory)
        ]

    def _table_views(self, vector: Tensor) -> dict[str, Tensor]:
        """Each parameter of all members, as a view: (members, ...)."""
        shapes = self.shape.parameters()
        parts = vector.view(self._members, -1).split_with_sizes([math.prod(shape) for shape in shapes.values()], 1)
        return {name: part.view(-1, *shapes[name]) for name, part in zip(shapes, parts, strict=True)}

    @property
    def named(self) -> dict[str, Tensor]:
        """Each parameter, as a view: (members, ...), or without that axis."""
        views = self._table_views(self.vector)
        return views if self.shape.members else {name: view[0] for name, view in views.items()}

    def __call__(self, x: Tensor, *, exact: bool = False) -> Tensor:
        """(n, in) -> (n, out), or (members, n, out). Differentiable by x and by `vector` where they require it.

        Args:
            x: inputs, the same for all members.
            exact: compute in float32 whatever the shape says.
        """
        if torch.is_grad_enabled() and (x.requires_grad or self.vector.requires_grad):
            outputs: Tensor = _Autograd.apply(x, self.vector, self, exact)  # type: ignore[no-untyped-call]
            return outputs
        return self.forward(x, exact=exact)[0]

    def _hidden_layers(self, *, bfloat16: bool) -> list[list[Affine]]:
        """The hidden layers of each group in the type they compute in, rounded again if `vector` has changed."""
        if not bfloat16:
            return [layers[:-1] for layers in self._layers]
        if self._rounded_version != self.vector._version:
            self._rounded.copy_(self.vector.view(self._members, -1)[:, : self._rounded.shape[1]])
            self._rounded_version = self.vector._version
        return self._rounded_layers

    def forward(self, x: Tensor, *, exact: bool = False, first: bool = False) -> tuple[Tensor, list[Tape]]:
        """Outputs as of a call, and a tape for each group of members, for `backward`.

        With `first` only the first member is needed: the others are left out where members are computed one by one.
        """
        bfloat16 = self.shape.bfloat16 and not exact
        if bfloat16:
            x = x.bfloat16()
        count = 1 if first else len(self._groups)
        outputs, tapes = [], []
        for hidden, layers in zip(self._hidden_layers(bfloat16=bfloat16)[:count], self._layers[:count], strict=True):
            output, tape = backprop.forward(x, hidden, layers[-1], layer_norm=self.shape.layer_norm)
            outputs.append(output)
            tapes.append(tape)
        if not self.shape.members or outputs[0].dim() == 3:
            return outputs[0], tapes
        return torch.stack(outputs), tapes

    def backward(
        self, gradient: Tensor, tapes: list[Tape], *, parameters: bool = True, columns: slice | None = None
    ) -> Tensor | None:
        """From the gradient by the outputs to that by the parameters, written to `gradient`, and by the inputs.

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
        hidden_layers = self._hidden_layers(bfloat16=bfloat16)
        out = self._rounded_gradients if bfloat16 else self._gradients
        for group, tape in enumerate(tapes):
            last = self._layers[group][-1]
            by_input = backprop.backward(
                gradient[group] if self.shape.members and last.weight.dim() == 2 else gradient,
                tape,
                hidden_layers[group],
                last,
                out=out[group] if parameters else None,
                columns=columns,
                scratch=self._scratch,
            )
            total = by_input if total is None or by_input is None else total.add_(by_input)
        if parameters and bfloat16:
            self.gradient.view(self._members, -1)[:, : self._rounded.shape[1]].copy_(self._rounded_gradient)
        return total

    def copy(self) -> MLP:
        """A network with equal parameters in a vector of its own: a target network."""
        other = MLP(self.shape, torch.Generator(), str(self.vector.device))
        other.vector.copy_(self.vector.detach())
        return other

    def follow(self, other: MLP, tau: float) -> None:
        """Polyak averaging: parameters = (1 - tau) parameters + tau other's parameters."""
        self.vector.lerp_(other.vector, tau)

    def state(self) -> State:
        return {name: view.detach().clone() for name, view in self.named.items()}

    @torch.no_grad()
    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of a network of another shape."""
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


def _words(shapes: Mapping[str, tuple[int, ...]]) -> str:
    return ", ".join(f"{name} {'x'.join(map(str, dimensions))}" for name, dimensions in shapes.items())


ALL = slice(None)


def deployed(network: MLP, normaliser: Normaliser, output: Output, *, columns: slice = ALL) -> Deployed:
    """Normaliser and network for use outside karolos, as copies on the CPU.

    Args:
        network: without members.
        normaliser: of its inputs.
        output: how the network's outputs become an action.
        columns: of the outputs that the action needs.
    """
    parts = {name: to_array(part.detach()).copy() for name, part in network.named.items()}
    layers = [
        Layer(parts[f"layer{number}.weight"], parts[f"layer{number}.bias"].reshape(-1))
        for number in range(len(network.shape.sizes) - 1)
    ]
    last = layers.pop()
    layers.append(Layer(last.weight[columns], last.bias[columns]))
    shift, scale = (to_array(part).copy() for part in normaliser.terms)
    return Deployed(shift, scale, normaliser.clip, tuple(layers), output, EPSILON if network.shape.layer_norm else None)
