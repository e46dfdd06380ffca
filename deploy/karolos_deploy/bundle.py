"""A bundle: the folder that `karolos export --bundle` writes, read and checked."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import yaml

from .kinematics import Array, Chain, chain_of
from .policy import NumpyPolicy
from .readings import Observer, Reading

FORMAT, JOINTS_FORMAT = 1, 2
"""Version of a bundle's layout; that with the formulas of OF_JOINTS."""
SUMS = "SHA256SUMS"
TOLERANCE = 1e-4
"""Largest allowed difference from a golden action or observation: float32 sums in another order differ."""

Policy = Callable[[Any, Any], Any]


class BundleError(Exception):
    """A bundle cannot be used: one line that says what is wrong and what to do."""


class Bundle:
    """A policy with the contract of its inputs and outputs. Every file is checked against its SHA-256.

    Args:
        onnx: whether onnxruntime runs policy.onnx; otherwise numpy runs policy.npz.

    Attributes:
        contract: the content of policy.yaml under `karolos`.

    Raises:
        BundleError: a file is missing or changed, the format differs, or the policy does not act as recorded.
    """

    def __init__(self, folder: str | PathLike[str], *, onnx: bool = False) -> None:
        self.folder = Path(folder)
        check_sums(self.folder)
        with _readable(self.folder):
            self._read(onnx=onnx)

    def _read(self, *, onnx: bool) -> None:
        with (self.folder / "policy.yaml").open(encoding="utf-8") as file:
            whole = yaml.load(file, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        self.contract: dict[str, Any] = whole["karolos"]
        if (found := self.contract["format"]) not in (FORMAT, JOINTS_FORMAT):
            raise BundleError(
                f"{self.folder} has format {found}; this version reads formats {FORMAT} and {JOINTS_FORMAT}"
            )
        self.chain: Chain = chain_of(self.contract)
        self.policy: Policy = _onnx_policy(self.folder) if onnx else NumpyPolicy(self.folder / "policy.npz")
        with np.load(self.folder / "golden.npz", allow_pickle=False) as golden:
            acted = self.policy(golden["observation"], golden["desired_goal"])
            self._compare("golden.npz", "action", acted, golden["action"])

    def episode(self) -> dict[str, Array]:
        """The logged episode, by column: one row for each control step."""
        with np.load(self.folder / "episode.npz", allow_pickle=False) as file:
            return dict(file)

    def replay_episode(self) -> int:
        """Build each observation of the logged episode from its readings, and act, without a robot. Returns the steps.

        Raises BundleError if an observation or action is not the recorded one.
        """
        with _readable(self.folder):
            return self._replay()

    def _replay(self) -> int:
        logged, observer = self.episode(), Observer({**self.contract, "wrench": {"filter": 0.0}})  # logged after it
        for step in range(len(logged["time"])):
            reading = Reading.logged(logged, step)
            observer.feel(reading)
            observer.overloaded = bool(logged["overloaded"][step])
            observation = observer(reading, self.chain.at(reading.positions), logged["set_point"][step])
            self._compare(f"step {step} of episode.npz", "observation", observation, logged["observation"][step])
            action = self.policy(observation, logged["desired_goal"][step])
            self._compare(f"step {step} of episode.npz", "action", action, logged["action"][step])
        return len(logged["time"])

    def _compare(self, where: str, what: str, found: Any, wanted: Any) -> None:
        error = float(np.abs(np.asarray(found, float) - wanted).max())
        if not error <= TOLERANCE * max(1.0, float(np.abs(wanted).max())):
            raise BundleError(
                f"golden mismatch: {where}: the {what} differs by {error:.2g}; do not use this bundle here"
            )


@contextmanager
def _readable(folder: Path) -> Iterator[None]:
    """Raise BundleError if files whose sums are right do not hold what a bundle needs: somebody edited them."""
    try:
        yield
    except (yaml.YAMLError, BadZipFile, LookupError, TypeError, ValueError) as error:
        what = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise BundleError(f"{folder} was edited, and is no whole bundle: {what}; export it again") from None


def check_sums(folder: Path) -> None:
    """Raise BundleError if a file of the bundle is missing, changed, or not in its list."""
    try:
        lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
        listed = {name: digest for digest, name in (line.split("  ", 1) for line in lines)}
    except (OSError, ValueError):
        raise BundleError(f"{folder} has no readable {SUMS}; `karolos export RUN --bundle` writes a bundle") from None
    for name, digest in listed.items():
        try:
            found = hashlib.sha256((folder / name).read_bytes()).hexdigest()
        except OSError:
            raise BundleError(f"{folder / name} is missing; copy the whole bundle again") from None
        if found != digest:
            raise BundleError(f"{folder / name} was changed or damaged; copy the whole bundle again")
    for needed in ("policy.yaml", "policy.npz", "golden.npz", "episode.npz"):
        if needed not in listed:
            raise BundleError(f"{folder / SUMS} does not name {needed}; copy the whole bundle again")


def write_sums(folder: Path) -> None:
    """Write the list of files that `check_sums` reads; `sha256sum -c` reads it, too."""
    names = sorted(path.name for path in folder.iterdir() if path.name != SUMS)
    lines = [f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in names]
    (folder / SUMS).write_text("".join(lines), encoding="utf-8", newline="\n")


def write_yaml(path: Path, whole: dict[str, Any]) -> None:
    """Write policy.yaml: plain data, a column of numbers in one line."""
    path.write_text(yaml.safe_dump(whole, sort_keys=False, default_flow_style=None, width=120), encoding="utf-8")


def _onnx_policy(folder: Path) -> Policy:
    try:
        import onnxruntime  # noqa: PLC0415  (optional)
    except ImportError:
        raise BundleError("onnxruntime is missing; pip install 'karolos-deploy[onnx]', or leave out --onnx") from None
    if not (folder / "policy.onnx").is_file():
        raise BundleError(f"{folder} has no policy.onnx; leave out --onnx")
    session = onnxruntime.InferenceSession(str(folder / "policy.onnx"), providers=["CPUExecutionProvider"])
    names = [one.name for one in session.get_inputs()]

    def act(observation: Any, desired_goal: Any) -> Any:
        rows = {"observation": np.atleast_2d(observation), "desired_goal": np.atleast_2d(desired_goal)}
        (found,) = session.run(["action"], {name: np.asarray(rows[name], np.float32) for name in names})
        return found if np.ndim(observation) > 1 else found[0]

    return act
