"""An environment that counts its steps, and an agent and buffer in one that records the calls of the training loop."""

from dataclasses import dataclass
from itertools import islice
from types import SimpleNamespace
from typing import ClassVar

import numpy as np

from karolos.core import Batch, Environment, Field, Layout, Signature, Step
from karolos.core.seeding import SeedTree
from karolos.orchestrator.local import Local
from karolos.training.training import Training


class Counter(Environment):
    """Observes (seed mod 1000, steps so far); ends after `seed mod 3 + 2` steps, truncated or, if even, terminated."""

    signature = Signature(
        observation=Layout((Field("seed", 1), Field("steps", 1))),
        action=Layout((Field("push", 2),)),
        max_steps=4,
        achieved_goal=Layout((Field("steps", 1),)),
        desired_goal=Layout((Field("goal", 1),)),
        parameters=Layout((Field("drawn", 1),)),
    )

    diverges = False
    fails = False
    actions: ClassVar[list] = []
    """Every action that an environment has taken."""

    def reset(self, seed: int) -> Step:
        if self.fails and seed % 11 == 0:
            raise ZeroDivisionError("it broke at a reset")
        self.seed, self.steps = seed, 0
        return self._step(0.0, False, False)

    def step(self, action) -> Step:
        self.actions.append(np.array(action))
        self.steps += 1
        if self.fails and self.steps == 2 and self.seed % 5 == 0:
            raise ZeroDivisionError("it broke at a step")
        over = self.steps == self.seed % 3 + 2
        return self._step(float(self.steps), over and self.seed % 2 == 0, over and self.seed % 2 == 1)

    def parameters(self):
        return np.array([self.seed % 7], np.float32)

    def _step(self, reward, terminated, truncated):
        observation = np.array([self.seed % 1000, self.steps], np.float32)
        steps = np.array([self.steps], np.float32)
        diverged = self.diverges and truncated
        goal = np.array([9.0], np.float32)
        return Step(observation, steps, goal, reward, terminated, truncated, self.steps == 2, diverged)


@dataclass
class Recorder:
    """Agent and buffer in one: its action is the number of updates so far in thousandths; it records every call."""

    on_policy = False

    def __post_init__(self):
        self.added, self.sampled, self.learned, self.priorities, self.cuts, self.begun = [], [], 0, [], [], []

    def begin_episodes(self, environments):
        self.begun.append((len(self.added), environments.tolist()))

    def act(self, observation, desired_goal, *, explore, environments):
        assert explore
        assert environments.shape == (len(observation),)
        assert desired_goal.shape == (len(observation), 1)
        return np.full((len(observation), 2), self.learned / 1000, np.float32)

    def add(self, transitions):
        self.added.append(type(transitions)(*(np.array(field) for field in transitions)))

    def __len__(self):
        return len(self.added) or 1  # pretraining learns before anything is added

    def cut(self, environments):
        self.cuts.append((len(self.added), environments.tolist()))

    def sample(self, size):
        self.sampled.append((size, len(self.added)))
        return Batch(*([None] * 8), slot=np.arange(size))

    def learn(self, batch):
        self.learned += 1
        return {"loss": np.float32(self.learned), "priorities": np.ones(batch.slot.size, np.float32)}

    def update_priorities(self, slot, priorities):
        self.priorities.append((slot.size, priorities.size))


@dataclass
class OnPolicyRecorder(Recorder):
    """The same, on-policy: a rollout is three rounds, an action is out of bounds, a rollout makes five updates."""

    on_policy = True
    taken = 0

    def act(self, observation, desired_goal, *, explore, environments):
        return super().act(observation, desired_goal, explore=explore, environments=environments) + np.float32(
            [3.0, -3.0]
        )

    def __len__(self):
        waiting = len(self.added) - self.taken
        return 3 * waiting if waiting == 3 else 0

    def sample(self, size):
        self.taken = len(self.added)
        return super().sample(size)

    def learn(self, batch):
        self.learned += 1
        return {"loss": np.float32(self.learned), "updates": 5}


def train(
    *,
    environments=3,
    recorder=None,
    failures=0,
    pretraining_updates=0,
    at_least=None,
    rounds=None,
    state=None,
    orchestrator=Local,
    **amounts,
):
    """Train to the end, or for some rounds, from the beginning or from a state: progress, recorder, training."""
    amounts = {"steps": 60, "batch_size": 4, "replay_ratio": 2.0, "warmup_episodes": 2} | amounts
    recorder = Recorder() if recorder is None else recorder
    settings = Local.Settings(processes=0, environments=environments, failures=failures)
    with orchestrator(settings, Counter) as made:
        given = SimpleNamespace(**amounts)
        training = Training(made, recorder, recorder, given, SeedTree(7), at_least, pretraining_updates)
        if state is not None:
            training.load_state(state)
        return list(islice(training.rounds(), rounds)), recorder, training


def updates_per_round(progress):
    return np.diff([0, *(round.updates for round in progress)]).tolist()
