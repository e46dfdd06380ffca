"""Plays episodes of a policy or of the task's expert for a recording, in many environments at the same time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import isfinite

import numpy as np

from ..core import Array, Discrete, Environment, Field, FloatArray, Layout, Orchestrator, Signature, Step
from ..core.seeding import SeedTree
from ..environments.build import build_environment
from ..errors import RunError, UsageError
from ..specification.parts import Recipe
from .recording import Played, Recording, RecordingFolder

EXPERT = Field("expert_action", 0)
"""The field of observations in which `WithExpert` gives the expert's next action. It has the size of an action."""
MOST_PLAYED = 100
"""Largest number of played episodes per wanted episode, so that recording a policy that never succeeds ends."""
Act = Callable[[Step], FloatArray]
"""The action (a,) after a step."""


class Around(Environment):
    """An environment around another one, which does whatever a subclass does not change."""

    def __init__(self, environment: Environment) -> None:
        self.environment = environment
        self.signature, self.rate = environment.signature, environment.rate

    def reset(self, seed: int) -> Step:
        return self.environment.reset(seed)

    def step(self, action: Array) -> Step:
        return self.environment.step(action)

    def parameters(self) -> FloatArray:
        return self.environment.parameters()

    def measures(self) -> FloatArray:
        return self.environment.measures()

    def close(self) -> None:
        self.environment.close()


class WithExpert(Around):
    """An environment whose observations end with the next action of the task's expert.

    Experts can therefore play in other processes, too. Raises UsageError if there is no expert.
    """

    def __init__(self, environment: Environment) -> None:
        super().__init__(environment)
        signature = environment.signature
        if isinstance(signature.action, Discrete):
            raise UsageError("experts give continuous actions", setting="environment.actions")
        shown = Layout((replace(EXPERT, size=signature.action.size),))
        self.signature = replace(signature, observation=signature.observation + shown)

    def reset(self, seed: int) -> Step:
        step = super().reset(seed)
        self.acting = self.environment.expert()
        self.acting.reset()
        return self._shown(step)

    def step(self, action: Array) -> Step:
        return self._shown(super().step(action))

    def _shown(self, step: Step) -> Step:
        over = step.terminated or step.truncated
        action = np.zeros(self.signature.action.size) if over else self.acting.act()
        return step._replace(observation=np.concatenate((step.observation, np.asarray(action, np.float32))))


def build_recorded(recipe: Recipe, *, expert: bool) -> Environment:
    """The environment of a recipe, with or without its expert. Raises as `build_environment`."""
    environment = build_environment(recipe)
    return WithExpert(environment) if expert else environment


def expert_act(signature: Signature) -> Act:
    """The policy that takes the action in the observations of `WithExpert`."""
    size = signature.action.size
    return lambda step: step.observation[-size:]


@dataclass
class Recorder:
    """Plays episodes until `episodes` are kept, and writes each into the folder.

    Episode k has the k-th seed. Episodes are written in the order of their seeds, not of their ends, so that short
    episodes are not favoured. A row's action does not depend on other rows. Therefore neither the number of
    environments nor an interruption changes it.

    Args:
        seeds: root of the seeds of episodes and noise.
        folder: begun; episodes that it holds are not played again.
        only_success: keep only episodes whose goal is reached at the last step.
        noise: standard deviation of Gaussian noise on continuous actions.
        random: probability that an action is uniformly random.
        hidden: columns at the end of observations that are not recorded.
        on_episode: is called after each episode with the number of kept ones.
    """

    environments: Orchestrator
    act: Act
    seeds: SeedTree
    folder: RecordingFolder
    episodes: int
    only_success: bool = False
    noise: float = 0.0
    random: float = 0.0
    hidden: int = 0
    on_episode: Callable[[int], object] = lambda _: None
    _steps: dict[int, list[Step]] = field(default_factory=dict, init=False)
    """Steps of the running episode of each environment, beginning with its reset."""
    _actions: dict[int, list[FloatArray]] = field(default_factory=dict, init=False)

    def run(self) -> list[Played]:
        """Play until enough episodes are kept. Returns all played episodes, in order.

        Raises RunError if hardly any episode can be kept.
        """
        played = self.folder.played()
        kept = sum(one.kept for one in played)
        ended: dict[int, tuple[Played, Recording]] = {}
        episode: dict[int, int] = {}
        """The episode of each environment."""
        upcoming, idle = len(played), list(range(self.environments.size))
        while kept < self.episodes:
            for environment in idle:
                episode[environment] = upcoming
                self._begin(environment, upcoming)
                upcoming += 1
            idle = self._round(episode)
            for environment in idle:
                ended[episode[environment]] = self._recorded(environment, episode[environment])
            while len(played) in ended and kept < self.episodes:
                outcome, recording = ended.pop(len(played))
                self.folder.add(outcome, recording)
                played.append(outcome)
                kept += outcome.kept
                self.on_episode(kept)
            if len(played) >= MOST_PLAYED * self.episodes:
                what = f"{kept} of {len(played)} episodes succeed, and {self.episodes} are wanted"
                raise RunError(what, where=str(self.folder.path), hint="record a better policy, or leave out --only")
        return played

    def _begin(self, environment: int, episode: int) -> None:
        seed = self.seeds.child("episode", episode).integer()
        self.environments.reset([environment], [seed])
        self._steps[environment], self._actions[environment] = [], []

    def _round(self, episode: dict[int, int]) -> list[int]:
        """One step of all environments; returns those whose episodes are over."""
        received = self.environments.receive()
        for environment in received.failed.tolist():  # it plays its episode again
            self._begin(environment, episode[environment])
        ready, actions, over = list[int](), list[FloatArray](), list[int]()
        for row, environment in enumerate(received.environment.tolist()):
            step = received.step.select(np.array(row))
            self._steps[environment].append(step)
            if step.terminated or step.truncated:
                over.append(environment)
                continue
            node = self.seeds.child("noise", episode[environment], len(self._actions[environment]))
            action = self._varied(np.asarray(self.act(step), np.float32), node)
            self._actions[environment].append(action)
            ready.append(environment)
            actions.append(action)
        if ready:
            self.environments.step(ready, np.stack(actions))
        return over

    def _varied(self, action: FloatArray, node: SeedTree) -> FloatArray:
        """The action with noise, or a random one."""
        if not (self.noise or self.random):
            return action
        generator = node.generator()
        if generator.random() < self.random:
            return generator.uniform(-1, 1, action.shape).astype(np.float32)
        noisy = action + self.noise * generator.standard_normal(action.shape, np.float32)
        return np.clip(noisy, -1, 1).astype(np.float32)

    def _recorded(self, environment: int, index: int) -> tuple[Played, Recording]:
        steps, actions = self._steps[environment], self._actions[environment]
        columns = Step(*(np.stack(column) for column in zip(*steps, strict=True)))
        observed = columns.observation[:, : columns.observation.shape[1] - self.hidden]
        seed = self.seeds.child("episode", index).integer()
        recording = Recording(
            observed,
            columns.achieved_goal,
            columns.desired_goal,
            np.stack(actions) if actions else np.zeros((0, self.environments.signature.action.size), np.float32),
            columns.reward[1:].astype(np.float32),
            columns.terminated[1:].astype(np.bool_),
            columns.truncated[1:].astype(np.bool_),
            columns.success.astype(np.bool_),
            seed,
        )
        success, diverged = bool(columns.success[-1]), bool(columns.diverged[-1])
        kept = not diverged and bool(actions) and (success or not self.only_success)
        values = self.environments.measures([environment])[0].tolist()
        declared = self.environments.signature.measures
        measures = {one.name: value for one, value in zip(declared, values, strict=True) if isfinite(value)}
        return Played(index, seed, len(actions), success, kept, diverged, measures), recording
