"""A trained policy as plain arrays, for export."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from .arrays import FloatArray

Output = Literal["tanh", "clip", "argmax"]
"""From the last layer's output to an action: tanh, clipped to [-1, 1], or the index of the largest column."""


@dataclass(frozen=True)
class Layer:
    """x -> x @ weight.T + bias."""

    weight: FloatArray
    """(columns out, columns in)"""
    bias: FloatArray
    """(columns out,)"""


@dataclass(frozen=True)
class Deployed:
    """A policy without exploration as float32 arrays.

    The input x is the observation concatenated with the desired goal, (n, i). Then x = clip((x - shift) * scale, -clip,
    clip), the layers with max(x, 0) between them, and `output`. With `layer_norm`, each hidden layer is normalised
    before max(x, 0): (x - mean) / sqrt(variance + layer_norm), with mean and variance over the row.
    """

    shift: FloatArray
    """(i,)"""
    scale: FloatArray
    """(i,)"""
    clip: float
    layers: tuple[Layer, ...]
    output: Output
    layer_norm: float | None = None
    """None: no layer normalisation."""

    @classmethod
    def read(cls, path: Path) -> Deployed:
        """The policy in a policy.npz that `karolos export` wrote."""
        with np.load(path, allow_pickle=False) as file:
            layers = [Layer(file[f"weight{place}"], file[f"bias{place}"]) for place in range(int(file["layers"]))]
            norm, output = float(file["layer_norm"]), str(file["output"])
            norms = None if np.isnan(norm) else norm
            return cls(file["shift"], file["scale"], float(file["clip"]), tuple(layers), output, norms)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        columns = [self.shift.size, *(layer.bias.size for layer in self.layers)]
        shapes = [layer.weight.shape for layer in self.layers]
        if self.scale.shape != self.shift.shape or shapes != list(zip(columns[1:], columns[:-1], strict=True)):
            raise ValueError(f"{columns[0]} inputs do not fit layers of shapes {shapes}")
