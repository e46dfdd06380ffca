"""What a trained policy is once nothing is learned any more: arrays, and how to go through them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .arrays import FloatArray

Output = Literal["tanh", "clip", "argmax"]
"""From the last layer's output to an action: squashed, or cut to [-1, 1]; or the index of the largest column."""


@dataclass(frozen=True)
class Layer:
    """x -> x @ weight.T + bias."""

    weight: FloatArray
    """(columns out, columns in)"""
    bias: FloatArray
    """(columns out,)"""


@dataclass(frozen=True)
class Deployed:
    """How an agent acts without exploration, in arrays of float32: all that an exported policy needs.

    With x the observation beside the desired goal, (n, i): x = clip((x - shift) * scale, -clip, clip); each layer, with
    max(x, 0) between two of them; output. With `layer_norm`, each hidden layer is normalised before its rectifier:
    (x - mean) / sqrt(variance + layer_norm), mean and variance over the row.
    """

    shift: FloatArray
    """(i,)"""
    scale: FloatArray
    """(i,)"""
    clip: float
    layers: tuple[Layer, ...]
    output: Output
    layer_norm: float | None = None
    """None: hidden layers are not normalised."""

    def __post_init__(self) -> None:
        columns = [self.shift.size, *(layer.bias.size for layer in self.layers)]
        shapes = [layer.weight.shape for layer in self.layers]
        if self.scale.shape != self.shift.shape or shapes != list(zip(columns[1:], columns[:-1], strict=True)):
            raise ValueError(f"{columns[0]} inputs do not go through layers of {shapes}")

    def is_finite(self) -> bool:
        """Whether every number is one."""
        parts = [self.shift, self.scale, *(part for layer in self.layers for part in (layer.weight, layer.bias))]
        return all(bool(np.isfinite(part).all()) for part in parts)
