"""Multi-layer perceptrons whose parameters lie in one vector, alone or several of one shape side by side.

At the size of robot-task networks an update is made of hundreds of operations of a few microseconds each. Hence one
vector for all parameters (an optimiser step, a step of a target network or a checkpoint is one operation), and the
chain rule written down instead of a graph for autograd.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from ..core import State
from ..errors import UsageError
from . import chain
from .chain import Tape
from .products import Affine, affine_map


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


class MLP:
    """Affine layers with rectifiers between them.

    Several members are computed as one product per layer on a GPU, where launches cost. On a CPU they are computed one
    after the other: two products of half the size take as long as one, and half-size activations stay in the cache.

    Agents write down their losses' gradients and call `forward` and `backward`; autograd sees nothing of either.

    Args:
        shape: layers, members, options.
        generator: draws the weights, on the CPU: uniform in +- 1 / sqrt(columns in), as torch.nn.Linear does.
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
        """What the latest `backward` found."""
        for layer, fan_in in enumerate(shape.sizes[:-1]):
            for name in (f"layer{layer}.weight", f"layer{layer}.bias"):
                part = self._table_views(self.vector)[name]
                part.copy_((torch.rand(part.shape, generator=generator) * 2 - 1) / fan_in**0.5)
        last = math.prod(self._shapes[-2]) + math.prod(self._shapes[-1])
        self._rounded = torch.zeros(
            (self._members, size - last if shape.low else 0), dtype=torch.bfloat16, device=device
        )
        """The hidden layers' parameters in bfloat16."""
        self._rounded_version = -1
        self._low_gradient = torch.zeros_like(self._rounded)
        """Where their gradient is put together, before `gradient` takes it in float32."""
        self._scratch = chain.Scratch()
        self._group(stacked=shape.members > 0 and self.vector.device.type != "cpu")

    def _group(self, *, stacked: bool) -> None:
        """Say which members are computed together, and find each group's parameters once and for all."""
        self._groups: list[slice | int] = [slice(0, self._members)] if stacked else list(range(self._members))
        self._exact_maps = self._maps(self.vector)
        self._into = self._views(self.gradient)
        self._rounded_maps = self._maps(self._rounded)
        low = self._views(self._low_gradient)
        self._low_into = [hidden + exact[-2:] for hidden, exact in zip(low, self._into, strict=True)]

    def _views(self, memory: Tensor) -> list[list[Tensor]]:
        """Weights and biases of each group, as views of memory laid out as all parameters are, or the hidden ones."""
        table = memory.view(self._members, -1)
        shapes = self._shapes if memory.dim() == 1 else self._shapes[:-2] if memory.numel() else []
        views = []
        for group in self._groups:
            lead = (-1,) if isinstance(group, slice) else ()
            parts = table[group].split_with_sizes([math.prod(shape) for shape in shapes], -1)
            views.append([part.view(*lead, *shape) for part, shape in zip(parts, shapes, strict=True)])
        return views

    def _maps(self, memory: Tensor) -> list[list[Affine]]:
        """The layers of each group, with parameters from such memory."""
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
        """(n, in) -> (n, out), or (members, n, out).

        Args:
            x: inputs, the same for all members.
            exact: compute in float32 whatever the shape says.
        """
        return self.forward(x, exact=exact)[0]

    def touch(self) -> None:
        """Say that the parameters have changed in a way that torch has not seen."""
        torch.autograd.graph.increment_version(self.vector)

    def _hidden_maps(self, *, low: bool) -> list[list[Affine]]:
        """The hidden layers with parameters in the type that they compute in; rounded anew when they have changed."""
        if not low:
            return [layers[:-1] for layers in self._exact_maps]
        if self._rounded_version != self.vector._version:
            self._rounded.copy_(self.vector.view(self._members, -1)[:, : self._rounded.shape[1]])
            self._rounded_version = self.vector._version
        return self._rounded_maps

    def forward(self, x: Tensor, *, exact: bool = False, first: bool = False) -> tuple[Tensor, list[Tape]]:
        """Outputs as of a call, and what `backward` needs: a tape for each group.

        With `first` the first member is enough: the others are left out where members are computed one by one.
        """
        low = self.shape.low and not exact
        if low:
            x = x.bfloat16()
        count = 1 if first else len(self._groups)
        outputs, tapes = [], []
        for hidden, layers in zip(self._hidden_maps(low=low)[:count], self._exact_maps[:count], strict=True):
            output, tape = chain.forward(x, hidden, layers[-1], layer_norm=self.shape.layer_norm)
            outputs.append(output)
            tapes.append(tape)
        if not self.shape.members or outputs[0].dim() == 3:
            return outputs[0], tapes
        return torch.stack(outputs), tapes

    def backward(
        self, gradient: Tensor, tapes: list[Tape], *, parameters: bool = True, columns: slice | None = None
    ) -> Tensor | None:
        """From the outputs' gradient to that of the parameters, left in `gradient`, and of the inputs.

        Args:
            gradient: as the outputs.
            tapes: of `forward`; the parameters must not have changed since.
            parameters: False: leave `gradient` as it is. True needs the tapes of all members.
            columns: of the inputs whose gradient is wanted.

        Returns:
            (n, columns), summed over the members; None where no columns are wanted.
        """
        low = tapes[0].low
        found: Tensor | None = None
        hidden_maps, into = self._hidden_maps(low=low), self._low_into if low else self._into
        for group, tape in enumerate(tapes):
            last = self._exact_maps[group][-1]
            for_x = chain.backward(
                gradient[group] if self.shape.members and last.weight.dim() == 2 else gradient,
                tape,
                hidden_maps[group],
                last,
                into=into[group] if parameters else None,
                columns=columns,
                scratch=self._scratch,
            )
            found = for_x if found is None or for_x is None else found.add_(for_x)
        if parameters and low:
            self.gradient.view(self._members, -1)[:, : self._rounded.shape[1]].copy_(self._low_gradient)
        return found

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


def _words(shapes: Mapping[str, tuple[int, ...]]) -> str:
    return ", ".join(f"{name} {'x'.join(map(str, dimensions))}" for name, dimensions in shapes.items())
