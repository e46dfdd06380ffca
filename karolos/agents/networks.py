"""Multi-layer perceptrons whose parameters lie in one vector, alone or several of one shape side by side.

One vector makes an optimiser step, a step of a target network and a checkpoint one operation each, instead of one per
weight: at the size of robot-task networks the overhead of those costs as much as the arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from ..core import State
from ..errors import UsageError
from .products import affine


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

    def parameters(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of each parameter of one member, in their order in the vector."""
        shapes: dict[str, tuple[int, ...]] = {}
        for layer, (before, after) in enumerate(pairwise(self.sizes)):
            shapes[f"layer{layer}.weight"] = (after, before)
            shapes[f"layer{layer}.bias"] = (after,)
        return shapes


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
        columns = sum(math.prod(dimensions) for dimensions in shape.parameters().values())
        self.vector = torch.zeros(rows * columns, device=device)
        """All parameters, one member after the other."""
        self.vector.grad = torch.zeros_like(self.vector)
        table = self.vector.view(rows, columns)
        self._gradients = self.vector.grad.view(rows, columns)
        self.named: dict[str, Tensor] = {}
        """Each parameter as a view of `vector`: (members, ...), or without that axis."""
        start = 0
        for name, dimensions in shape.parameters().items():
            end = start + math.prod(dimensions)
            fan_in = shape.sizes[int(name.removeprefix("layer").split(".")[0])]
            drawn = torch.rand((rows, end - start), generator=generator) * 2 - 1
            table[:, start:end] = drawn / fan_in**0.5
            view = table[:, start:end].view(rows, *dimensions)
            self.named[name] = view if shape.members else view[0]
            start = end
        together = shape.members and torch.device(device).type != "cpu"
        self._groups = [slice(0, rows)] if together or not shape.members else [slice(k, k + 1) for k in range(rows)]
        """Members that are computed together."""
        self._fixed = [self._views(group, together) for group in self._groups]
        self._learned = [[view.detach().requires_grad_() for view in views] for views in self._fixed]

    def _views(self, group: slice, together: Any) -> list[Tensor]:
        """The parameters of these members, in the shapes that `affine` takes."""
        views = [view if self.shape.members else view[None] for view in self.named.values()]
        if not together:
            return [view[group.start] for view in views]
        return [view if view.dim() == 3 else view[:, None] for view in views]

    def __call__(self, x: Tensor, *, learn: bool = False, exact: bool = False) -> Tensor:
        """(n, in) -> (n, out), or (members, n, out).

        Args:
            x: inputs, the same for all members.
            learn: let gradients flow to the parameters; to the inputs they always do.
            exact: compute in float32 whatever the shape says.
        """
        if self.shape.low and not exact:
            x = x.bfloat16()
        groups = self._learned if learn else self._fixed
        if not self.shape.members:
            return self._pass(x, groups[0])
        if len(groups) == 1:
            return self._pass(x.expand(self.shape.members, *x.shape), groups[0])
        return torch.stack([self._pass(x, views) for views in groups])

    def _pass(self, x: Tensor, views: list[Tensor]) -> Tensor:
        normalise = self.shape.layer_norm
        *hidden, weight, bias = views
        for layer in range(0, len(hidden), 2):
            x = affine(x, hidden[layer], hidden[layer + 1], rectify=not normalise)
            if normalise:
                x = functional.relu(functional.layer_norm(x, x.shape[-1:]))
        return affine(x.float(), weight, bias, rectify=False)

    def differentiate(self, loss: Tensor) -> None:
        """Put the loss's gradient into `vector.grad`."""
        gradients = iter(torch.autograd.grad(loss, [view for views in self._learned for view in views]))
        for group, views in zip(self._groups, self._learned, strict=True):
            into = self._gradients[group]
            torch.cat([next(gradients).reshape(into.shape[0], -1) for _ in views], 1, out=into)

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
