"""The way through a network and back, written down: the chain rule for affine layers with rectifiers between them.

Autograd would do the same with four times the operations, and in float32 only.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from .products import Affine, affine, product, product_into, rectified_rows, rectifier_back

EPSILON = 1e-5
"""Added to the variance in layer normalisation, as in torch.nn.LayerNorm."""
_NORM_BACK = torch.ops.aten.native_layer_norm_backward.default


class Tape(NamedTuple):
    """What the way back needs of a forward pass through one network, or through members computed together."""

    entered: list[Tensor]
    """What entered each hidden layer, and what left the last of them: (n, units) each."""
    last: Tensor
    """What entered the last layer: float32."""
    norms: list[tuple[Tensor, Tensor, Tensor]]
    """Of each normalised layer: what was normalised, its mean, and one over its spread."""

    @property
    def low(self) -> bool:
        """Whether hidden layers were computed in bfloat16."""
        return self.last.dtype != self.entered[-1].dtype

    def rows(self, first: int, count: int) -> Tape:
        """The same of some of the rows."""

        def part(tensor: Tensor) -> Tensor:
            return tensor.narrow(-2, first, count)

        norms = [(part(raw), part(mean), part(scale)) for raw, mean, scale in self.norms]
        return Tape([part(h) for h in self.entered], part(self.last), norms)


class Scratch:
    """Memory for the gradients on the way back, kept because fresh memory costs as much as what is written to it."""

    def __init__(self) -> None:
        self._kept: list[Tensor] = []

    def like(self, tape: Tape) -> list[Tensor]:
        """For the gradients of what left the last hidden layer, in float32, and of each that computes in bfloat16."""
        low = tape.entered[1:] if tape.low else []
        kept = self._kept
        if not kept or kept[0].shape != tape.last.shape or len(kept) != 1 + len(low):
            self._kept = [torch.empty_like(tape.last), *map(torch.empty_like, low)]
        return self._kept


def forward(x: Tensor, hidden: list[Affine], last: Affine, *, layer_norm: bool) -> tuple[Tensor, Tape]:
    """(n, in) -> (n, out), or (members, n, out), in float32; hidden layers compute in the type of the inputs.

    Args:
        x: inputs.
        hidden: layers with a rectifier behind each.
        last: the layer without one.
        layer_norm: normalise before each rectifier.
    """
    h = x.expand(len(last.weight), *x.shape) if last.weight.dim() == 3 else x
    entered, norms = [h], []
    for layer in hidden:
        if layer_norm:
            raw = affine(h, layer, rectify=False)
            h, mean, scale = torch.native_layer_norm(raw, raw.shape[-1:], None, None, EPSILON)
            h.relu_()
            norms.append((raw, mean, scale))
        else:
            h = affine(h, layer, rectify=True)
        entered.append(h)
    h = h.float()
    return affine(h, last, rectify=False), Tape(entered, h, norms)


def backward(
    g: Tensor,
    tape: Tape,
    hidden: list[Affine],
    last: Affine,
    *,
    into: list[Tensor] | None,
    columns: slice | None,
    scratch: Scratch,
) -> Tensor | None:
    """From the outputs' gradient to that of the parameters, and of the inputs.

    Args:
        g: (n, out), or (members, n, out).
        tape: of `forward`.
        hidden: as there.
        last: as there.
        into: where to write the gradients of weights and biases, layer by layer; None: nowhere.
        columns: of the inputs whose gradient is wanted.
        scratch: memory.

    Returns:
        (n, columns) in float32, summed over members; None where no columns are wanted.
    """
    if into is not None:
        _store(g, tape.last, into[-2:])
    wide, *low = scratch.like(tape)
    at_end = g if last.weight.shape[-2] == 1 and into is None else None
    if at_end is not None:  # one output, so that g only scales rows: cheapest on the few columns of the end
        d = rectified_rows(last.weight, tape.entered[-1], low[-1] if low else wide)
    else:
        # With one column out the product is an outer one, which both libraries are slow at.
        (torch.mul if last.weight.shape[-2] == 1 else torch.matmul)(g, last.weight, out=wide)
        d = rectifier_back(wide, tape.last)
        d = low[-1].copy_(d) if low else d
    for number in reversed(range(len(hidden))):
        if tape.norms:
            raw, mean, scale = tape.norms[number]
            d = _NORM_BACK(d, raw, raw.shape[-1:], mean, scale, None, None, [True, False, False])[0]
        if into is not None:
            _store(d, tape.entered[number], into[2 * number : 2 * number + 2])
        if number:
            weight = hidden[number].weight
            d = torch.matmul(d, weight, out=low[number - 1]) if low else product(d, weight)
            d = rectifier_back(d, tape.entered[number])
    if columns is None:
        return None
    for_x = torch.matmul(d, hidden[0].weight[..., columns]).float()
    for_x = for_x if at_end is None else for_x.mul_(at_end)
    return for_x if for_x.dim() == 2 else for_x.sum(0)


def _store(gradient: Tensor, entered: Tensor, into: list[Tensor]) -> None:
    """Write the gradients of an affine map's weight and bias."""
    product_into(gradient.mT, entered, into[0])
    torch.sum(gradient, -2, keepdim=True, out=into[1])
