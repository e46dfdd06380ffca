"""Bits flipped one at a time until they match the goal: a sparse reward that needs hindsight."""

from __future__ import annotations

import numpy as np
from pydantic import Field as Setting

from ..core import Array, BoolArray, Discrete, Environment, Field, GoalRule, Layout, Signature, Step
from ..core import Settings as BaseSettings
from .action_set import action_index


class SameBits(GoalRule):
    """Success, the end of the episode and reward 0 where all bits match, else -1."""

    reward_range = (-1.0, 0.0)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        return np.asarray((np.asarray(achieved) == desired).all(-1))

    def terminated(self, achieved: Array, desired: Array) -> BoolArray:
        return self.success(achieved, desired)


class BitFlip(Environment):
    """What to do: flip bits, one per step, until they equal the bits of the goal.

    What is randomised: the bits and the goal, each pattern equally likely, never equal at reset.

    Observation: the bits (0 or 1).
    Action: the index of the bit to flip.
    Goals: achieved, the bits; desired, the bits of the goal.
    Reward: -1 per step, 0 for the step that reaches the goal.
    What counts as success: all bits equal the goal's.
    Termination: on success, because no action keeps the bits unchanged; truncated after `bits` steps, which is enough
    for every goal.

    Source: Andrychowicz et al. 2017, "Hindsight Experience Replay", section 3.1, which leaves open whether success ends
    the episode.
    """

    class Settings(BaseSettings):
        bits: int = Setting(15, ge=1, le=50, description="number of bits, and of steps per episode")

    def __init__(self, settings: BitFlip.Settings) -> None:
        self.settings = settings
        bits = settings.bits
        self._rule = SameBits()
        self._actions = Discrete(tuple(f"flip bit {bit}" for bit in range(bits)))
        self.signature = Signature(
            observation=Layout((Field("bits", bits),)),
            action=self._actions,
            max_steps=bits,
            reward_range=self._rule.reward_range,
            achieved_goal=Layout((Field("bits", bits),)),
            desired_goal=Layout((Field("goal_bits", bits),)),
            goal_rule=self._rule,
        )
        self._steps = bits  # no episode is running

    def reset(self, seed: int) -> Step:
        generator = np.random.Generator(np.random.PCG64(seed))
        self._bits = generator.integers(2, size=self.settings.bits).astype(np.float32)
        self._goal = generator.integers(2, size=self.settings.bits).astype(np.float32)
        while self._rule.success(self._bits, self._goal):
            self._goal = generator.integers(2, size=self.settings.bits).astype(np.float32)
        self._steps = 0
        return self._step(0.0, over=False)

    def step(self, action: Array) -> Step:
        """Flip one bit. Raises ValueError for an invalid index, RuntimeError when the episode is over."""
        bit = action_index(action, self._actions, "BitFlip")
        if self._steps >= self.settings.bits:
            raise RuntimeError("the episode is over; reset the environment first")
        self._bits = self._bits.copy()
        self._bits[bit] = 1 - self._bits[bit]
        self._steps += 1
        step = self._step(float(self._rule.reward(self._bits, self._goal)), over=self._steps >= self.settings.bits)
        if step.terminated:
            self._steps = self.settings.bits
        return step

    def _step(self, reward: float, *, over: bool) -> Step:
        success = bool(self._rule.success(self._bits, self._goal))
        return Step(self._bits, self._bits, self._goal, reward, success, over and not success, success)

    def render(self, width: int = 640, height: int = 480) -> np.ndarray:
        """The bits above, the goal below, ones dark; bits that differ from the goal are red."""
        bits, goal = self._bits > 0, self._goal > 0
        colours = np.full((2, bits.size, 3), (40, 80, 200))
        colours[0, bits != goal] = 200, 60, 40
        zeros = ~np.stack([bits, goal])
        colours[zeros] = 255 - (255 - colours[zeros]) // 4
        rows, columns = np.arange(height) * 2 // height, np.arange(width) * bits.size // width
        return colours[rows][:, columns].astype(np.uint8)
