"""Matrix products and affine maps by the fastest kernel of this machine. They are not differentiable.

On x86 PyTorch computes float32 products with MKL, which reaches 117 GFLOP/s on one Zen 5 core where oneDNN reaches 240
(measured, sides of 256). `_linear_pointwise` calls oneDNN; the result is exact up to float32 rounding. Products in
bfloat16 always run on oneDNN, at 450 GFLOP/s.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor


def _one_dnn() -> Any:
    """oneDNN's affine map; None in a build of PyTorch without it."""
    if not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]
        return None
    operator = getattr(torch.ops.mkldnn, "_linear_pointwise", None)
    return None if operator is None else operator.default


_AFFINE = _one_dnn()
_NOTHING: list[Any] = []
_THRESHOLD_BACKWARD = torch.ops.aten.threshold_backward.grad_input
NARROW = 16
"""With fewer output columns a call of oneDNN costs more than it saves."""


class Affine(NamedTuple):
    """The parameters of one affine map, or of k maps side by side.

    Built once per layer: the choice of the kernel costs as much Python time as a small product.
    """

    weight: Tensor
    """(o, i) or (k, o, i)."""
    bias: Tensor
    """(1, o) or (k, 1, o)."""
    transposed: Tensor
    flat_bias: Tensor | None
    """(o,) if oneDNN is the fastest kernel, else None."""


def affine_map(weight: Tensor, bias: Tensor) -> Affine:
    """The map x weight^T + bias: (o, i) and (1, o), or (k, o, i) and (k, 1, o)."""
    one_dnn = _AFFINE is not None and weight.dim() == 2 and weight.device.type == "cpu" and weight.shape[0] >= NARROW
    return Affine(weight, bias, weight.mT, bias[0] if one_dnn else None)


def affine(x: Tensor, layer: Affine, *, relu: bool) -> Tensor:
    """x weight^T + bias, then max(0, .) if `relu`: (n, i) -> (n, o), or (k, n, i) -> (k, n, o)."""
    if layer.flat_bias is not None:
        y: Tensor = _AFFINE(x, layer.weight, layer.flat_bias, "relu" if relu else "none", _NOTHING, "")
        return y
    add = torch.addmm if layer.weight.dim() == 2 else torch.baddbmm
    y = add(layer.bias, x, layer.transposed)
    return y.relu_() if relu else y


def matmul(a: Tensor, b: Tensor) -> Tensor:
    """a b: (n, i) (i, o), or (k, n, i) (k, i, o)."""
    if (
        a.dtype == torch.float32
        and a.dim() == 2
        and _AFFINE is not None
        and a.device.type == "cpu"
        and min(*a.shape, *b.shape) >= NARROW
    ):
        y: Tensor = _AFFINE(a, b.mT, None, "none", [], "")
        return y
    return a @ b


def matmul_into(a: Tensor, b: Tensor, out: Tensor) -> None:
    """Write a b into a contiguous `out`; shapes as in `matmul`."""
    if a.dtype == torch.bfloat16 or min(*a.shape, *b.shape) < NARROW:
        torch.matmul(a, b, out=out)
    else:
        out.copy_(matmul(a, b))


def relu_backward(gradient: Tensor, activation: Tensor) -> Tensor:
    """Set the gradient to 0, in place, where the rectifier's output `activation` is 0.

    bfloat16 values are multiplied as 16-bit integers. A CPU converts them to float32 for any other operation, which
    takes twice as long.
    """
    if gradient.dtype == torch.bfloat16:
        gradient.view(torch.int16).mul_(_is_positive(activation))
    else:
        _THRESHOLD_BACKWARD(gradient, activation, 0, grad_input=gradient)
    return gradient


def relu_backward_of_row(row: Tensor, activation: Tensor, out: Tensor) -> Tensor:
    """Write `relu_backward` of one gradient row (1, u), repeated for each row of `activation`, into `out` (n, u)."""
    if activation.dtype == torch.bfloat16:
        torch.mul(_is_positive(activation), row.bfloat16().view(torch.int16), out=out.view(torch.int16))
    else:
        _THRESHOLD_BACKWARD(row.expand_as(activation), activation, 0, grad_input=out)
    return out


def _is_positive(activation: Tensor) -> Tensor:
    """1 where a bfloat16 activation is positive, else 0. The bits of a number >= 0 read as an integer >= 0."""
    return activation.view(torch.int16).clamp(0, 1)
