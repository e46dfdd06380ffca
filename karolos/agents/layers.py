"""Affine layers with rectifiers between them: forward and backward pass by the fastest kernels of this machine.

On x86 PyTorch computes float32 products with MKL. On one Zen 5 core MKL reaches 117 GFLOP/s and oneDNN 240 (measured,
sides of 256). On a Zen 3 core, without AVX-512, MKL reaches 80 and oneDNN 65. `_linear_pointwise` calls
oneDNN; the result is exact up to float32 rounding. Products in bfloat16 run on oneDNN, at 450 GFLOP/s, if it has
kernels for the CPU. Autograd needs four times as many operations for the same gradient.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from . import norm_kernel

LAYER_NORM_EPSILON = 1e-5
"""Added to the variance in layer normalisation, as in torch.nn.LayerNorm."""
NARROW_COLUMNS = 16
"""With fewer output columns a call of oneDNN costs more than it saves."""
NARROW_FLOAT32 = 64
"""In float32 MKL is faster where a side is below this, as in most first layers."""
_EPSILON = np.float32(LAYER_NORM_EPSILON)
_NORMALISE, _NORMALISE_BACKWARD = norm_kernel.normalise.unchecked(), norm_kernel.normalise_backward.unchecked()
_LAYER_NORM_BACKWARD = torch.ops.aten.native_layer_norm_backward.default
_THRESHOLD_BACKWARD = torch.ops.aten.threshold_backward.grad_input
_NO_SCALARS: list[Any] = []


def _one_dnn(dtype: torch.dtype) -> Any:
    """oneDNN's affine map; None where PyTorch is built without it, it has no kernel, or MKL is faster."""
    operator = getattr(torch.ops.mkldnn, "_linear_pointwise", None)
    if operator is None or not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]
        return None
    if dtype == torch.bfloat16:
        serves = torch.ops.mkldnn._is_mkldnn_bf16_supported()
    else:
        serves = torch.backends.cpu.get_cpu_capability() != "AVX2"
    return operator.default if serves else None


_AFFINES = {dtype: _one_dnn(dtype) for dtype in (torch.float32, torch.bfloat16)}
"""oneDNN's affine map by type; None: PyTorch's products are used."""


class Affine(NamedTuple):
    """The parameters of the map x weight^T + bias, or their gradients."""

    weight: Tensor
    """(o, i)."""
    bias: Tensor
    """(o,)."""


class Tape(NamedTuple):
    """The values of a forward pass that the backward pass needs."""

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

    def rows(self, first: int) -> Tape:
        """The tape of the rows from `first` on."""
        norms = [(raw[first:], mean[first:], scale[first:]) for raw, mean, scale in self.norms]
        return Tape([h[first:] for h in self.activations], self.last_input[first:], norms)


def forward(x: Tensor, layers: list[Affine], *, layer_norm: bool) -> tuple[Tensor, Tape]:
    """(n, in) -> (n, out) in float32; all layers but the last one compute in the type of `x`.

    Args:
        layers: with a rectifier behind each but the last one.
        layer_norm: normalise before each rectifier.
    """
    h, activations, norms = x, [x], []
    for layer in layers[:-1]:
        if layer_norm:
            raw = _affine(h, layer, relu=False)
            h, means, scales = normalised(raw)
            norms.append((raw, means, scales))
        else:
            h = _affine(h, layer, relu=True)
        activations.append(h)
    h = h.float()
    return _affine(h, layers[-1], relu=False), Tape(activations, h, norms)


def backward(
    gradient: Tensor, tape: Tape, layers: list[Affine], *, out: list[Affine] | None, columns: slice | None
) -> Tensor | None:
    """Compute the gradients by the parameters and by the inputs from the gradient by the outputs.

    Args:
        gradient: by the outputs, (n, out).
        out: receives the gradients by the parameters of each layer; None: they are not computed.
        columns: input columns whose gradient is wanted.

    Returns:
        The gradient by the input columns: (n, columns) in float32. None if `columns` is None.
    """
    last = layers[-1].weight
    if out is not None:
        _parameter_gradients(gradient, tape.last_input, out[-1])
    # With one output and no parameter gradient, `gradient` only scales rows. It is applied last, to the few columns.
    row_scale = gradient if len(last) == 1 and out is None else None
    if row_scale is not None:
        d = _relu_backward_of_row(last, tape.activations[-1])
    else:
        # With one output the product is an outer product, which both libraries compute slowly.
        d = gradient * last if len(last) == 1 else gradient @ last
        d = _relu_backward(d, tape.last_input).to(tape.activations[-1].dtype)
    for number in reversed(range(len(layers) - 1)):
        if tape.norms:
            d = normalised_backward(d, *tape.norms[number])
        if out is not None:
            _parameter_gradients(d, tape.activations[number], out[number])
        if number:
            d = _relu_backward(_matmul(d, layers[number].weight), tape.activations[number])
    if columns is None:
        return None
    # MKL multiplies few rows with a matrix five times as fast as a matrix with few columns.
    by_input = torch.matmul(layers[0].weight[:, columns].mT, d.mT).mT.float()
    return by_input if row_scale is None else by_input.mul_(row_scale)


def normalised(raw: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The normalised and rectified rows of `raw` (n, u), their means and 1 / standard deviations (n, 1)."""
    if raw.is_cuda or raw.dtype == torch.bfloat16:
        h, means, scales = torch.native_layer_norm(raw, raw.shape[-1:], None, None, LAYER_NORM_EPSILON)
        return h.relu_(), means, scales
    h, means, scales = torch.empty_like(raw), raw.new_empty((len(raw), 1)), raw.new_empty((len(raw), 1))
    _NORMALISE(raw.numpy(), _EPSILON, h.numpy(), means.numpy(), scales.numpy())
    return h, means, scales


def normalised_backward(gradient: Tensor, raw: Tensor, means: Tensor, scales: Tensor) -> Tensor:
    """The gradient by `raw` from the one by its normalised rows, which may be overwritten: (n, u)."""
    if raw.is_cuda or raw.dtype == torch.bfloat16:
        arguments = gradient, raw, raw.shape[-1:], means, scales, None, None, [True, False, False]
        by_raw: Tensor = _LAYER_NORM_BACKWARD(*arguments)[0]
        return by_raw
    gradient = gradient.contiguous()
    _NORMALISE_BACKWARD(gradient.numpy(), raw.numpy(), means.numpy(), scales.numpy())
    return gradient


def _affine(x: Tensor, layer: Affine, *, relu: bool) -> Tensor:
    """x weight^T + bias, then max(0, .) if `relu`: (n, i) -> (n, o)."""
    affine = None if x.is_cuda else _AFFINES[x.dtype]
    wide = len(layer.weight) >= NARROW_COLUMNS and (x.dtype == torch.bfloat16 or x.shape[1] >= NARROW_FLOAT32)
    if wide and affine is not None:
        y: Tensor = affine(x, layer.weight, layer.bias, "relu" if relu else "none", _NO_SCALARS, "")
        return y
    y = torch.addmm(layer.bias, x, layer.weight.mT)
    return y.relu_() if relu else y


def _matmul(a: Tensor, b: Tensor) -> Tensor:
    """a b: (n, i) (i, o)."""
    affine = None if a.is_cuda or a.dtype == torch.bfloat16 else _AFFINES[torch.float32]
    if affine is not None and min(*a.shape, *b.shape) >= NARROW_COLUMNS:
        y: Tensor = affine(a, b.mT, None, "none", _NO_SCALARS, "")
        return y
    return a @ b


def _parameter_gradients(gradient: Tensor, x: Tensor, out: Affine) -> None:
    """Write the gradients by weight and bias of an affine map of x into `out`."""
    narrow = min(*gradient.shape, *x.shape) < NARROW_FLOAT32
    if narrow or gradient.dtype == torch.bfloat16 or _AFFINES[torch.float32] is None:
        torch.matmul(gradient.mT, x, out=out.weight)
    else:
        out.weight.copy_(_matmul(gradient.mT, x))
    torch.sum(gradient, 0, out=out.bias)


def _relu_backward(gradient: Tensor, activation: Tensor) -> Tensor:
    """Set the gradient to 0, in place, where the rectifier's output `activation` is 0.

    bfloat16 values are multiplied as 16-bit integers. A CPU converts them to float32 for any other operation, which
    takes twice as long.
    """
    if gradient.dtype == torch.bfloat16:
        gradient.view(torch.int16).mul_(_is_positive(activation))
    else:
        _THRESHOLD_BACKWARD(gradient, activation, 0, grad_input=gradient)
    return gradient


def _relu_backward_of_row(row: Tensor, activation: Tensor) -> Tensor:
    """`_relu_backward` of one gradient row (1, u), repeated for each row of `activation`: (n, u)."""
    if activation.dtype == torch.bfloat16:
        return torch.mul(_is_positive(activation), row.bfloat16().view(torch.int16)).view(torch.bfloat16)
    gradient: Tensor = torch.ops.aten.threshold_backward(row.expand_as(activation), activation, 0)
    return gradient


def _is_positive(activation: Tensor) -> Tensor:
    """1 where a bfloat16 activation is positive, else 0. The bits of a number >= 0 read as an integer >= 0."""
    return activation.view(torch.int16).clamp(0, 1)
