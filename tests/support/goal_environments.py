"""Goal environments of gymnasium as anybody writes them, under ids such as support.goal_environments:Point-v0."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict


class Point(gymnasium.Env):
    """A point that moves by its action has to come near its goal."""

    metadata = {"render_modes": [], "render_fps": 10}  # noqa: RUF012  (gymnasium reads it from the class)

    def __init__(self, dense: bool = False, ends: bool = False, apart: bool = False, fault: str = "") -> None:
        plane = Box(-1, 1, (2,), np.float64)
        self.observation_space = Dict(observation=plane, achieved_goal=plane, desired_goal=plane)
        self.action_space = Box(-1, 1, (2,), np.float32)
        self.dense, self.ends, self.apart, self.fault = dense, ends, apart, fault

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place, self.goal = self.np_random.uniform(-1, 1, (2, 2))
        if self.apart:
            self.goal[0] = np.clip(self.place[0] + np.copysign(0.3, -self.place[0]), -1, 1)
        return self.observe(), {}

    def observe(self) -> dict[str, Any]:
        return {"observation": self.place, "achieved_goal": self.place, "desired_goal": self.goal}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.place = np.clip(self.place + 0.2 * action, -1, 1)
        reached = bool(np.linalg.norm(self.place - self.goal) < 0.15)
        reward = float(self.compute_reward(self.place, self.goal, {})) - (self.fault == "reward")
        return self.observe(), reward, self.ends and reached, False, {"is_success": reached}

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        distance = np.linalg.norm(achieved_goal - desired_goal, axis=None if self.fault == "one goal" else -1)
        return -distance if self.dense else -(distance >= 0.15).astype(np.float32)


class Ending(Point):
    """Says itself when an episode is terminated, for one goal at a time as gymnasium-robotics does."""

    def __init__(self, apart: bool = False) -> None:
        super().__init__(ends=True, apart=apart)

    def compute_terminated(self, achieved_goal: Any, desired_goal: Any, info: Any) -> bool:
        return bool(np.linalg.norm(achieved_goal - desired_goal) < 0.15)


class Straying(Point):
    """Depends on how often it was reset, in whatever episode."""

    resets = 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        Straying.resets += 1
        self.place = np.clip(self.place + 1e-3 * Straying.resets, -1, 1)
        return self.observe(), {}


class Pictures(gymnasium.Env):
    observation_space = Box(0, 255, (8, 8), np.uint8)
    action_space = gymnasium.spaces.Discrete(2)


gymnasium.register("Pictures-v0", Pictures, max_episode_steps=3)
gymnasium.register("Point-v0", Point, max_episode_steps=20)
gymnasium.register("Ending-v0", Ending, max_episode_steps=20)
gymnasium.register("Endless-v0", Point)
gymnasium.register("Straying-v0", Straying, max_episode_steps=20)
