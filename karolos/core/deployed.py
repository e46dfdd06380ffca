"""A trained policy as plain arrays, for export."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

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

    The input x is the observation o, the desired goal g and what is missing, g[missing[0]] - o[missing[1]], side by
    side. Then x = (x - shift) * scale, bounded by tanh(x) where it is what is missing and by clip(x, -clip, clip)
    elsewhere, the layers with max(x, 0) between them, and `output`. With `layer_norm`, each hidden layer is normalised
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
    missing: NDArray[np.int64] = field(default_factory=lambda: np.zeros((2, 0), np.int64))
    """(2, k): columns of the goal, and those of the observation that hold what is achieved of them."""

    @classmethod
    def read(cls, path: Path) -> Deployed:
        """The policy in a policy.npz that `karolos export` wrote."""
        with np.load(path, allow_pickle=False) as file:
            layers = [Layer(file[f"weight{place}"], file[f"bias{place}"]) for place in range(int(file["layers"]))]
            norm, output = float(file["layer_norm"]), str(file["output"])
            norms = None if np.isnan(norm) else norm
            known = file["shift"], file["scale"], float(file["clip"])
            return cls(*known, tuple(layers), output, norms, file["missing"])  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        columns = [self.shift.size, *(layer.bias.size for layer in self.layers)]
        shapes = [layer.weight.shape for layer in self.layers]
        if self.scale.shape != self.shift.shape or shapes != list(zip(columns[1:], columns[:-1], strict=True)):
            raise ValueError(f"{columns[0]} inputs do not fit layers of shapes {shapes}")
