"""The affine map that networks are made of, on the fastest product the machine has.

On x86 PyTorch sends float32 products to MKL, which leaves half of an AMD core unused: 117 GFLOP/s where oneDNN does 240
(one Zen 5 core, sides of 256, measured). oneDNN is reached through `_linear_pointwise`, exact to float32 rounding, and
through any product in bfloat16, at 450.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional


def _one_dnn() -> Any:
    """oneDNN's affine map, or None in a build of PyTorch without it."""
    if not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]
        return None
    return getattr(torch.ops.mkldnn, "_linear_pointwise", None)


_AFFINE = _one_dnn()


def affine(x: Tensor, weight: Tensor, bias: Tensor, *, rectify: bool) -> Tensor:
    """x weight^T + bias, then max(0, .) if `rectify`, in x's type; with gradients for x, weight and bias.

    Args:
        x: (n, i), or (k, n, i) for k networks side by side; float32 or bfloat16.
        weight: (o, i) or (k, o, i), float32.
        bias: (o) or (k, 1, o), float32.
        rectify: apply the rectifier; its gradient at 0 is 0.

    Returns: (n, o) or (k, n, o), of x's type.
    """
    if _AFFINE is not None and x.device.type == "cpu" and x.dim() == 2:
        found: Tensor = _Affine.apply(x, weight, bias, rectify)  # type: ignore[no-untyped-call]
        return found
    weight, bias = weight.to(x.dtype), bias.to(x.dtype)
    y = functional.linear(x, weight, bias) if x.dim() == 2 else torch.baddbmm(bias, x, weight.mT)
    return functional.relu(y) if rectify else y


class _Affine(torch.autograd.Function):
    """The affine map on oneDNN."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, rectify: bool) -> Tensor:
        kind = x.dtype
        weight = weight.to(kind)
        y: Tensor = _AFFINE(x, weight, bias.to(kind), "relu" if rectify else "none", [], "")
        ctx.rectify = rectify
        ctx.save_for_backward(x, weight, y if rectify else None)
        return y

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        x, weight, y = ctx.saved_tensors
        if ctx.rectify:
            gradient = torch.ops.aten.threshold_backward(gradient, y, 0)
        for_x = for_weight = for_bias = None
        if ctx.needs_input_grad[0]:
            # With one column out the product is an outer one, which both libraries are slow at.
            for_x = gradient * weight if weight.shape[0] == 1 else _product(gradient, weight)
        if ctx.needs_input_grad[1]:
            for_weight = _product(gradient.T, x).float()
            for_bias = gradient.sum(0).float()
        return for_x, for_weight, for_bias, None


def _product(a: Tensor, b: Tensor) -> Tensor:
    """a b, both of one type."""
    if a.dtype == torch.bfloat16:
        return a @ b  # goes to oneDNN of itself
    found: Tensor = _AFFINE(a, b.T, None, "none", [], "")
    return found
