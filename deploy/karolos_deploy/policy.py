"""Reads and runs an exported policy.npz. It needs only numpy, so this file can be copied to any place."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FORMAT, JOINTS_FORMAT = 2, 3
"""Version of the file's layout; that of a policy which treats joints alike."""


class NumpyPolicy:
    """An exported policy. Its actions are those of the agent without exploration.

    Raises:
        ValueError: the file has another format.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        with np.load(path, allow_pickle=False) as file:
            found = int(file["format"]) if "format" in file else None
            if found not in (FORMAT, JOINTS_FORMAT):
                raise ValueError(f"{path}: a policy of format {found}; this reads formats {FORMAT} and {JOINTS_FORMAT}")
            self.shift: NDArray[np.float32] = file["shift"]
            self.scale: NDArray[np.float32] = file["scale"]
            self.missing: NDArray[np.int64] = file["missing"]
            """(2, k): columns of the goal, and columns of the observation with their achieved values."""
            self.clip = float(file["clip"])
            self.epsilon = float(file["layer_norm"])
            """Added to the variance in layer normalisation; nan if hidden layers are not normalised."""
            self.output = str(file["output"])
            """How outputs become actions: tanh, clip or argmax."""
            self.layers: list[tuple[NDArray[np.float32], NDArray[np.float32]]] = [
                (file[f"weight{place}"], file[f"bias{place}"]) for place in range(int(file["layers"]))
            ]
            """Weight (out, in) and bias (out,) of each layer."""
            names = ("own", "shared", "order", "first_weight", "first_bias", "last_weight", "last_bias")
            self.joints: dict[str, NDArray[Any]] = {name: file[name] for name in names if found == JOINTS_FORMAT}
            """Columns and layers of a policy that treats joints alike, see `_by_joint`; otherwise empty."""

    def __call__(self, observation: ArrayLike, desired_goal: ArrayLike = ()) -> NDArray[np.float32] | NDArray[np.int64]:
        """The action for an observation (o,) and a goal (g,), or the actions for (n, o) and (n, g).

        Returns:
            (a,) or (n, a), float32 in [-1, 1]; for a discrete set the index, () or (n,), int64.

        Raises:
            ValueError: a number is nan or infinite; the number of inputs is not that of the policy, or
                observation or goal lacks a column of `missing`. The file does not say how many of them are the goal.
        """
        parts = [np.asarray(observation, np.float32), np.asarray(desired_goal, np.float32)]
        for name, part in zip(("observation", "desired_goal"), parts, strict=True):
            for place in np.argwhere(~np.isfinite(part))[:1]:
                raise ValueError(f"{name}[{place[-1]}] is not finite; policy.json says which field that is")
        if not parts[0].ndim or (parts[1].size and parts[0].shape[:-1] != parts[1].shape[:-1]):
            shapes = " and ".join(str(part.shape) for part in parts)
            raise ValueError(f"observation and goal have the shapes {shapes}; both are one row, or as many rows")
        count = self.missing.shape[1]
        seen, wanted = (part.shape[-1] for part in parts)
        if seen + wanted + count != self.shift.size:
            raise ValueError(
                f"observation and goal have {seen + wanted} numbers, the policy takes {self.shift.size - count}"
            )
        if count:
            least_wanted, least_seen = self.missing.max(axis=1) + 1
            if seen < least_seen or wanted < least_wanted:
                raise ValueError(
                    f"observation and goal have {seen} and {wanted} numbers, the policy takes at least {least_seen} "
                    f"and {least_wanted}"
                )
            parts.append(parts[1][..., self.missing[0]] - parts[0][..., self.missing[1]])
        x: NDArray[np.float32] = np.concatenate([part for part in parts if part.shape[-1]], axis=-1)
        scaled = (x - self.shift) * self.scale
        x = scaled.clip(-self.clip, self.clip)
        x[..., x.shape[-1] - count :] = np.tanh(scaled[..., x.shape[-1] - count :])
        x = self._by_joint(x) if self.joints else self._perceptron(x)
        if self.output == "argmax":
            return np.asarray(x.argmax(-1))
        return np.asarray(np.tanh(x), np.float32) if self.output == "tanh" else x.clip(-1, 1)

    def _perceptron(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        for place, (weight, bias) in enumerate(self.layers):
            if place:
                x = np.maximum(self._normalised(x), 0)
            x = x @ weight.T + bias
        return x

    def _by_joint(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        """The outputs if `first` and `last` are layers of each joint, and the perceptron sees sums over the joints."""
        known, shared = self.joints, x[..., self.joints["shared"]]
        own = x[..., known["own"]]  # (..., joints, columns)
        rows = np.concatenate((own, np.repeat(shared[..., None, :], own.shape[-2], -2)), -1)
        p, q, r, t, v = np.split(rows @ known["first_weight"].T + known["first_bias"], 5, -1)
        sums = np.concatenate((np.maximum(p, 0).sum(-2), (q * r).sum(-2)), -1) / np.float32(own.shape[-2] ** 0.5)
        said = self._perceptron(np.concatenate((sums, shared), -1))
        y, z, rest = np.split(said[..., None, :], [t.shape[-1], 2 * t.shape[-1]], -1)
        hidden = np.concatenate((np.maximum(t + y, 0), v * z), -1)
        each = hidden @ known["last_weight"].T + known["last_bias"]
        outputs = np.concatenate((each.reshape(*x.shape[:-1], -1), rest[..., 0, :]), -1)
        return np.asarray(outputs[..., known["order"]])

    def _normalised(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        if np.isnan(self.epsilon):
            return x
        centred = x - x.mean(-1, keepdims=True)
        variance = np.square(centred).mean(-1, keepdims=True)
        return np.asarray(centred / np.sqrt(variance + self.epsilon), np.float32)
