"""Environments of `gymnasium.make_vec` for stable-baselines3, which has an interface of its own."""

import gymnasium
from stable_baselines3.common.vec_env import VecEnv


class Together(VecEnv):
    def __init__(self, envs):
        self.envs = gymnasium.wrappers.vector.DictInfoToList(envs)
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self):
        return self.envs.reset(seed=self._seeds[0])[0]

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        observations, rewards, terminated, truncated, infos = self.envs.step(self.actions)
        ends = [info.get("final_info", info) for info in infos]
        for place, info in enumerate(infos):
            ends[place]["TimeLimit.truncated"] = truncated[place] and not terminated[place]
            ends[place]["terminal_observation"] = info.get("final_obs")
        return observations, rewards, terminated | truncated, ends

    def close(self):
        self.envs.close()

    def get_attr(self, name, indices=None):
        return [getattr(self.envs.unwrapped, name, None) for _ in self._get_indices(indices)]

    def set_attr(self, name, value, indices=None):
        raise NotImplementedError

    def env_method(self, name, *arguments, indices=None, **named):
        return [getattr(self.envs.unwrapped, name)(*arguments, **named) for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper, indices=None):  # noqa: ARG002
        return [False for _ in self._get_indices(indices)]
