"""Policies that ship with karolos: one exported policy in each folder of export/policies/.

policy.json names the run that a policy is from; its record stands in runs/reference of the project.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..core import Environment
from ..evaluation.changed_spec import changed_spec
from ..evaluation.policies import Policy, environment_of, signature_of
from ..files import read_object
from ..specification import Spec, spec_from_dict
from .numpy_policy import NumpyPolicy

FOLDER = Path(__file__).parent / "policies"


def shipped_names() -> tuple[str, ...]:
    """The names of the policies, in alphabetical order."""
    return tuple(sorted(path.parent.name for path in FOLDER.glob("*/policy.npz")))


def load_shipped(name: str, overrides: Sequence[str] = (), *, window: bool = False) -> tuple[Spec, Environment, Policy]:
    """A policy of `shipped_names`, with its spec and one environment like the one that it was trained in.

    Args:
        name: of the policy.
        overrides: as for `changed_spec`.
        window: whether to show the world in a window.

    Raises:
        SpecError: an override is not valid.
        UsageError: an override is about training, or changes a layout.
        MachineError: there is no display for the window.
    """
    described = read_object(FOLDER / name / "policy.json") or {}
    world = described["trained_in"]
    world["environment"].pop("engine", None)  # any installed engine does
    spec = spec_from_dict({"name": name, "agent": described["agent"], **world})
    spec = changed_spec(spec, overrides, trained=signature_of(spec))
    policy = NumpyPolicy(FOLDER / name / "policy.npz")
    acts = Policy(lambda step: np.asarray(policy(step.observation, step.desired_goal), np.float32))
    return spec, environment_of(spec, randomize=True, window=window), acts
