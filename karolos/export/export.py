"""Writes a run's policy to files that act without karolos.

policy.npz   the policy as arrays, which NumpyPolicy reads
policy.onnx  the same as an ONNX model
policy.json  meaning of its inputs and outputs, and its origin
golden.npz   inputs and the agent's own actions for them, to check a port against
"""

from __future__ import annotations

import importlib.util
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from karolos_deploy.policy import FORMAT, JOINTS_FORMAT, NumpyPolicy

from ..core import Deployed
from ..core.seeding import SeedTree
from ..environments.build import used
from ..errors import RunError
from ..evaluation.policies import SavedAgent, environment_of, load_agent, playable
from ..records import RunFolder, provenance
from ..system.files import write_json, writing
from .onnx_file import check_onnx, run_onnx, write_onnx

GOLDEN_ROWS = 64
LARGEST_ERROR = 1e-4
"""Largest allowed difference between actions of the files and of the agent. Another order of float32 sums gave 3e-6 in
a policy with two layers of 256 after 10,000 steps of training. A mistake in the files gives far more. """


@dataclass(frozen=True)
class Exported:
    """Result of an export."""

    folder: Path
    files: tuple[Path, ...]
    checkpoint: str
    steps: int
    """Environment steps that the policy was trained for."""
    error: float
    """The largest difference between the agent's actions and those of the files, over GOLDEN_ROWS random inputs."""


def export_policy(folder: RunFolder, out: Path, *, checkpoint: str = "best", onnx: bool | None = None) -> Exported:
    """Write a run's policy for use without karolos; files of an earlier export there are replaced.

    Args:
        out: folder to write to; it is created if it is missing.
        checkpoint: `best` or `last`.
        onnx: whether to write policy.onnx too; None: if the package onnx is installed.

    Raises:
        UsageError: this kind of agent cannot be exported.
        RunError: the checkpoint is missing or damaged, or the written files do not act as the agent does.
        MachineError: the package onnx is missing, or the folder cannot be written.
    """
    if onnx is None:
        onnx = importlib.util.find_spec("onnx") is not None
    elif onnx:
        check_onnx()
    saved = load_agent(folder, checkpoint)
    policy = saved.agent.deployed()
    layers = [part for layer in policy.every_layer for part in (layer.weight, layer.bias)]
    numbers = [policy.shift, policy.scale, *layers]
    if not all(np.isfinite(part).all() for part in numbers):
        raise RunError("the policy has weights that are nan or infinite", where=folder.id)
    described = description(folder, saved, policy)
    golden = golden_samples(saved, policy)
    paths = {name: out / name for name in ("policy.npz", "policy.json", "golden.npz")}
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        (out / "policy.onnx").unlink(missing_ok=True)  # otherwise the model of an older export could stay
        np.savez(paths["policy.npz"], **arrays(policy))
        np.savez(paths["golden.npz"], **golden)
    write_json(paths["policy.json"], described)
    if onnx:
        paths["policy.onnx"] = out / "policy.onnx"
        sizes = (saved.signature.observation.acting.size, saved.signature.desired_goal.size)
        write_onnx(paths["policy.onnx"], policy, sizes, {"karolos": json.dumps(described)})
    acted = [NumpyPolicy(paths["policy.npz"])(golden["observation"], golden["desired_goal"])]
    if onnx:
        acted.append(run_onnx(paths["policy.onnx"], golden))
    error = max(float(np.abs(found - golden["action"]).max()) for found in acted)
    if not error <= LARGEST_ERROR:
        for path in paths.values():
            path.unlink()  # they must not be used
        raise RunError(
            f"the written policy does not act like the agent: actions differ by {error:.2g}", where=folder.id
        )
    return Exported(out, tuple(paths.values()), saved.checkpoint, saved.steps, error)


def arrays(policy: Deployed) -> dict[str, Any]:
    """Content of policy.npz, by name."""
    found: dict[str, Any] = {
        "format": np.int64(format_of(policy)),
        "shift": policy.shift,
        "scale": policy.scale,
        "missing": policy.missing,
        "clip": np.float32(policy.clip),
        "layer_norm": np.float32(np.nan if policy.layer_norm is None else policy.layer_norm),
        "output": np.str_(policy.output),
        "layers": np.int64(len(policy.layers)),
        **{f"weight{place}": layer.weight for place, layer in enumerate(policy.layers)},
        **{f"bias{place}": layer.bias for place, layer in enumerate(policy.layers)},
    }
    if (joints := policy.joints) is not None:
        found |= {"own": joints.own, "shared": joints.shared, "order": joints.order}
        found |= {"first_weight": joints.first.weight, "first_bias": joints.first.bias}
        found |= {"last_weight": joints.last.weight, "last_bias": joints.last.bias}
    return found


def format_of(policy: Deployed) -> int:
    """The lowest version of policy.npz that can hold the policy: older readers read what they can."""
    return FORMAT if policy.joints is None else JOINTS_FORMAT


def golden_samples(saved: SavedAgent, policy: Deployed) -> dict[str, Any]:
    """Random inputs with three times the spread of the agent's inputs, and its own actions for them.

    observation (n, o), desired_goal (n, g), action (n, a), or for a discrete set the index (n,).
    """
    size = saved.signature.observation.acting.size
    noise = SeedTree(0).child("export").generator().normal(size=(GOLDEN_ROWS, policy.shift.size))
    inputs = (policy.shift + 3 * noise / policy.scale).astype(np.float32)
    observation, goal = inputs[:, :size].copy(), inputs[:, size : policy.shift.size - policy.missing.shape[1]].copy()
    action = saved.agent.act(observation, goal, explore=False)
    if policy.output == "argmax":
        action = action[:, 0].astype(np.int64)
    return {"observation": observation, "desired_goal": goal, "action": action}


def description(folder: RunFolder, saved: SavedAgent, policy: Deployed) -> dict[str, Any]:
    """Content of policy.json."""
    spec, signature = saved.spec.dump(), saved.signature
    with used(environment_of(playable(saved.spec))) as environment:
        facts: dict[str, Any] = getattr(getattr(environment, "robot", None), "facts", dict)()
    return {
        "format": format_of(policy),
        "run": folder.id,
        "checkpoint": saved.checkpoint,
        "sha256": saved.sha256,
        "steps": saved.steps,
        "karolos": provenance.versions()["karolos"],
        "agent": spec["agent"]["name"],
        "output": policy.output,
        "observation": signature.observation.acting.described(),
        "desired_goal": signature.desired_goal.described(),
        "action": signature.action.described(),
        "robot": facts,
        "trained_in": {key: spec[key] for key in ("robot", "task", "environment") if key in spec},
    }
