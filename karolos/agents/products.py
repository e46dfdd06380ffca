"""The two products that networks are made of, on the fastest road the machine has. No gradients: networks.py has them.

On x86 PyTorch sends float32 products to MKL, which leaves half of an AMD core unused: 117 GFLOP/s where oneDNN does 240
(one Zen 5 core, sides of 256, measured). oneDNN is reached through `_linear_pointwise`, exact to float32 rounding, and
through any product in bfloat16, at 450.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor


def _one_dnn() -> Any:
    """oneDNN's affine map, or None in a build of PyTorch without it."""
    if not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]
        return None
    found = getattr(torch.ops.mkldnn, "_linear_pointwise", None)
    return None if found is None else found.default


_AFFINE = _one_dnn()
_NOTHING: list[Any] = []
_THRESHOLD_BACK = torch.ops.aten.threshold_backward.grad_input
NARROW = 16
"""With fewer columns out than this a call of oneDNN costs more than it saves."""


class Affine(NamedTuple):
    """The parameters of an affine map, or of k side by side, with what `affine` needs of them at hand.

    Made once, because finding out what is best for a layer costs Python as long as a small product.
    """

    weight: Tensor
    """(o, i) or (k, o, i)."""
    bias: Tensor
    """(1, o) or (k, 1, o)."""
    transposed: Tensor
    flat_bias: Tensor | None
    """(o,) where oneDNN is the fastest road; else None."""


def affine_map(weight: Tensor, bias: Tensor) -> Affine:
    """The map x weight^T + bias: (o, i) and (1, o), or (k, o, i) and (k, 1, o)."""
    one_dnn = _AFFINE is not None and weight.dim() == 2 and weight.device.type == "cpu" and weight.shape[0] >= NARROW
    return Affine(weight, bias, weight.mT, bias[0] if one_dnn else None)


def affine(x: Tensor, layer: Affine, *, rectify: bool) -> Tensor:
    """x weight^T + bias, then max(0, .) if `rectify`: (n, i) -> (n, o), or (k, n, i) -> (k, n, o)."""
    if layer.flat_bias is not None:
        found: Tensor = _AFFINE(x, layer.weight, layer.flat_bias, "relu" if rectify else "none", _NOTHING, "")
        return found
    add = torch.addmm if layer.weight.dim() == 2 else torch.baddbmm
    y = add(layer.bias, x, layer.transposed)
    return y.relu_() if rectify else y


def product(a: Tensor, b: Tensor) -> Tensor:
    """a b: (n, i) (i, o), or (k, n, i) (k, i, o)."""
    if (
        a.dtype == torch.float32
        and a.dim() == 2
        and _AFFINE is not None
        and a.device.type == "cpu"
        and min(*a.shape, *b.shape) >= NARROW
    ):
        found: Tensor = _AFFINE(a, b.mT, None, "none", [], "")
        return found
    return a @ b


def product_into(a: Tensor, b: Tensor, out: Tensor) -> None:
    """Write a b into a contiguous `out`: shapes as in `product`."""
    if a.dtype == torch.bfloat16 or min(*a.shape, *b.shape) < NARROW:
        torch.matmul(a, b, out=out)
    else:
        out.copy_(product(a, b))


def rectified_rows(row: Tensor, left: Tensor, out: Tensor) -> Tensor:
    """A row (1, u) over and over, 0 where nothing left the rectifier, written to `out` of that shape: (n, u)."""
    if left.dtype == torch.bfloat16:
        torch.mul(_is_positive(left), row.bfloat16().view(torch.int16), out=out.view(torch.int16))
    else:
        _THRESHOLD_BACK(row.expand_as(left), left, 0, grad_input=out)
    return out


def _is_positive(left: Tensor) -> Tensor:
    """1 or 0, for what is never negative: as whole numbers bfloat16 bits are positive if the number is."""
    return left.view(torch.int16).clamp(0, 1)


def rectifier_back(gradient: Tensor, left: Tensor) -> Tensor:
    """0 where nothing left the rectifier, else as it was; in place.

    In bfloat16 the bits are multiplied as whole numbers: for all else a CPU makes float32 of them first, and that
    takes twice as long.
    """
    if gradient.dtype == torch.bfloat16:
        gradient.view(torch.int16).mul_(_is_positive(left))
    else:
        _THRESHOLD_BACK(gradient, left, 0, grad_input=gradient)
    return gradient
