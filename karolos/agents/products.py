"""The two products that networks are made of, on the fastest road the machine has. No gradients: networks.py has them.

On x86 PyTorch sends float32 products to MKL, which leaves half of an AMD core unused: 117 GFLOP/s where oneDNN does 240
(one Zen 5 core, sides of 256, measured). oneDNN is reached through `_linear_pointwise`, exact to float32 rounding, and
through any product in bfloat16, at 450.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


def _one_dnn() -> Any:
    """oneDNN's affine map, or None in a build of PyTorch without it."""
    if not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]
        return None
    return getattr(torch.ops.mkldnn, "_linear_pointwise", None)


_AFFINE = _one_dnn()
NARROW = 16
"""With fewer columns out than this a call of oneDNN costs more than it saves."""


def affine(x: Tensor, weight: Tensor, bias: Tensor, *, rectify: bool) -> Tensor:
    """x weight^T + bias, then max(0, .) if `rectify`: (n, o), or (k, n, o) for k networks side by side.

    Args:
        x: (n, i) or (k, n, i).
        weight: (o, i) or (k, o, i).
        bias: (1, o) or (k, 1, o).
        rectify: whether to cut negative results off.
    """
    if x.dim() == 3:
        y = torch.baddbmm(bias, x, weight.mT)
    elif _AFFINE is not None and x.device.type == "cpu" and weight.shape[0] >= NARROW:
        found: Tensor = _AFFINE(x, weight, bias[0], "relu" if rectify else "none", [], "")
        return found
    else:
        y = torch.addmm(bias, x, weight.mT)
    return y.relu_() if rectify else y


def product(a: Tensor, b: Tensor) -> Tensor:
    """a b: (n, i) (i, o), or (k, n, i) (k, i, o)."""
    if (
        _AFFINE is not None
        and a.dim() == 2
        and a.device.type == "cpu"
        and a.dtype == torch.float32
        and min(a.shape + b.shape) >= NARROW
    ):
        found: Tensor = _AFFINE(a, b.mT, None, "none", [], "")
        return found
    return a @ b
