#!/usr/bin/env python3
"""Print test episodes of policies that ship, in MuJoCo, without PyTorch: python tests/scripts/episodes.py.

One line per episode, with the sha256 of every observation, goal and reward. Two Pythons on one machine print the same.
"""

from __future__ import annotations

import hashlib
import json

from karolos.environments.build import opened
from karolos.evaluation.testing import test_seeds
from karolos.export import NumpyPolicy
from karolos.records.shipped import FOLDER, POLICY
from karolos.registry import load
from karolos.specification.parts import Part, Recipe

NAMES = ("panda_pick", "ur5_push", "iiwa_throw")
EPISODES = 4


def part(spec: dict[str, dict[str, object]], key: str, **changed: object) -> Part:
    settings = {**spec[key], **changed}
    kind, name = f"{key}s", str(settings.pop("name"))
    return Part(kind, name, load(kind, name).Settings.model_validate(settings))


for shipped in NAMES:
    spec = json.loads((FOLDER / shipped / "resolved.json").read_text(encoding="utf-8"))
    recipe = Recipe(part(spec, "environment", engine="mujoco"), part(spec, "robot"), part(spec, "task"))
    policy = NumpyPolicy(FOLDER / shipped / POLICY)
    with opened(recipe) as environment:
        for episode, seed in enumerate(test_seeds(spec["testing"]["seed"], EPISODES)):
            digest = hashlib.sha256()
            step, steps = environment.reset(seed), 0
            while not (step.terminated or step.truncated):
                step, steps = environment.step(policy(step.observation, step.desired_goal)), steps + 1
                for values in (step.observation, step.achieved_goal, step.desired_goal):
                    digest.update(values.tobytes())
                digest.update(repr(float(step.reward)).encode())
            print(shipped, episode, f"{steps} steps, success {bool(step.success)},", digest.hexdigest())
