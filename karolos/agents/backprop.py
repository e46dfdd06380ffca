"""Forward and backward pass of affine layers with rectifiers between them.

Autograd needs four times as many operations for the same gradient.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from .matmul import Affine, affine, matmul, matmul_into, relu_backward, relu_backward_of_row

EPSILON = 1e-5
"""Added to the variance in layer normalisation, as in torch.nn.LayerNorm."""
_LAYER_NORM_BACKWARD = torch.ops.aten.native_layer_norm_backward.default


class Tape(NamedTuple):
    """Activations of a forward pass through one network, or through members computed together."""

    activations: list[Tensor]
    """The input of each hidden layer and the output of the last one: (n, units) each."""
    last_input: Tensor
    """The input of the last layer, in float32."""
    norms: list[tuple[Tensor, Tensor, Tensor]]
    """For each normalised layer: its value before normalisation, the mean, and 1 / standard deviation."""

    @property
    def bfloat16(self) -> bool:
        """Whether the hidden layers were computed in bfloat16."""
        return self.last_input.dtype != self.activations[-1].dtype

    def rows(self, first: int, count: int) -> Tape:
        """The tape of `count` rows from `first` on."""

        def part(tensor: Tensor) -> Tensor:
            return tensor.narrow(-2, first, count)

        norms = [(part(raw), part(mean), part(scale)) for raw, mean, scale in self.norms]
        return Tape([part(h) for h in self.activations], part(self.last_input), norms)


class Scratch:
    """Reused memory for gradients of activations: allocating it costs as much time as writing to it."""

    def __init__(self) -> None:
        self._memory: list[Tensor] = []

    def like(self, tape: Tape) -> list[Tensor]:
        """One float32 tensor shaped as the last layer's input, then one per hidden layer computed in bfloat16."""
        rounded = tape.activations[1:] if tape.bfloat16 else []
        memory = self._memory
        if not memory or memory[0].shape != tape.last_input.shape or len(memory) != 1 + len(rounded):
            self._memory = [torch.empty_like(tape.last_input), *map(torch.empty_like, rounded)]
        return self._memory


def forward(x: Tensor, hidden: list[Affine], last: Affine, *, layer_norm: bool) -> tuple[Tensor, Tape]:
    """(n, in) -> (n, out), or (members, n, out), in float32; hidden layers compute in the type of `x`.

    Args:
        x: inputs.
        hidden: layers with a rectifier behind each.
        last: the layer without one.
        layer_norm: normalise before each rectifier.
    """
    h = x.expand(len(last.weight), *x.shape) if last.weight.dim() == 3 else x
    activations, norms = [h], []
    for layer in hidden:
        if layer_norm:
            raw = affine(h, layer, relu=False)
            h, mean, scale = torch.native_layer_norm(raw, raw.shape[-1:], None, None, EPSILON)
            h.relu_()
            norms.append((raw, mean, scale))
        else:
            h = affine(h, layer, relu=True)
        activations.append(h)
    h = h.float()
    return affine(h, last, relu=False), Tape(activations, h, norms)


def backward(
    gradient: Tensor,
    tape: Tape,
    hidden: list[Affine],
    last: Affine,
    *,
    out: list[Tensor] | None,
    columns: slice | None,
    scratch: Scratch,
) -> Tensor | None:
    """From the gradient by the outputs to the gradients by the parameters and by the inputs.

    Args:
        gradient: by the outputs, (n, out) or (members, n, out).
        tape: of `forward`.
        hidden: as in `forward`.
        last: as in `forward`.
        out: receives the gradients by weight and bias of each layer, in order; None: they are not computed.
        columns: input columns whose gradient is wanted.
        scratch: memory.

    Returns:
        The gradient by the input columns: (n, columns) in float32, summed over members. None if `columns` is None.
    """
    if out is not None:
        _affine_gradients(gradient, tape.last_input, out[-2:])
    wide, *rounded = scratch.like(tape)
    # With one output and no parameter gradient, `gradient` only scales rows. It is applied last, to the few columns.
    row_scale = gradient if last.weight.shape[-2] == 1 and out is None else None
    if row_scale is not None:
        d = relu_backward_of_row(last.weight, tape.activations[-1], rounded[-1] if rounded else wide)
    else:
        # With one output the product is an outer product, which both libraries compute slowly.
        (torch.mul if last.weight.shape[-2] == 1 else torch.matmul)(gradient, last.weight, out=wide)
        d = relu_backward(wide, tape.last_input)
        d = rounded[-1].copy_(d) if rounded else d
    for layer in reversed(range(len(hidden))):
        if tape.norms:
            raw, mean, scale = tape.norms[layer]
            d = _LAYER_NORM_BACKWARD(d, raw, raw.shape[-1:], mean, scale, None, None, [True, False, False])[0]
        if out is not None:
            _affine_gradients(d, tape.activations[layer], out[2 * layer : 2 * layer + 2])
        if layer:
            weight = hidden[layer].weight
            d = torch.matmul(d, weight, out=rounded[layer - 1]) if rounded else matmul(d, weight)
            d = relu_backward(d, tape.activations[layer])
    if columns is None:
        return None
    by_input = torch.matmul(d, hidden[0].weight[..., columns]).float()
    by_input = by_input if row_scale is None else by_input.mul_(row_scale)
    return by_input if by_input.dim() == 2 else by_input.sum(0)


def _affine_gradients(gradient: Tensor, x: Tensor, out: list[Tensor]) -> None:
    """Write the gradients by weight and bias of an affine map of x into `out`."""
    matmul_into(gradient.mT, x, out[0])
    torch.sum(gradient, -2, keepdim=True, out=out[1])
