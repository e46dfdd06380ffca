"""Promises of every environment."""

from __future__ import annotations

import numpy as np

from ...core import Environment, FloatArray, Step, random_actions
from .case import Candidate, Promises, demand, demand_refusal, demand_same, demand_same_fields, demand_shape
from .joined import opened

STARTS = 300
"""Seeds whose goal must not be reached at the start."""
BEGINS, PROMISES, REPEATS = Promises(opened, basic=True), Promises(opened), Promises()


@BEGINS
def an_episode_begins_and_takes_a_step(environment: Environment) -> None:
    """The environment can be built, begins an episode and takes a step."""
    environment.reset(0)
    environment.step(_actions(environment, 0, 1)[0])


@REPEATS
def the_same_seed_gives_the_same_trajectory_in_a_fresh_and_in_a_used_environment(*who: Candidate) -> None:
    """A seed and the actions determine an episode and its measures, independent of earlier episodes."""
    with opened(*who) as environment, opened(*who) as fresh:
        first, measures = _played(environment, 3), environment.measures().tobytes()
        _played(environment, 4)
        environment.reset(5)  # an episode that is left unfinished
        environment.step(_actions(environment, 0, 1)[0])
        for what, used in (("in a used environment", environment), ("in a fresh environment", fresh)):
            again = _played(used, 3)
            counts = f"{len(again) - 1} instead of {len(first) - 1}"
            demand(len(again) == len(first), f"an episode of the same seed has {counts} steps {what}")
            for number, (one, other) in enumerate(zip(first, again, strict=True)):
                demand_same_fields(one, other, f"step {number} {what}")
            demand(used.measures().tobytes() == measures, f"an episode of the same seed has other measures {what}")


@PROMISES
def different_seeds_give_different_episodes(environment: Environment) -> None:
    """Different seeds give different first observations or goals."""
    starts = [environment.reset(seed) for seed in range(4)]
    different = {(step.observation.tobytes(), step.desired_goal.tobytes()) for step in starts}
    demand(len(different) == 4, f"4 seeds give {len(different)} different starts")


@PROMISES
def steps_are_as_the_signature_says(environment: Environment) -> None:
    """Observations and goals have the signature's shapes in float32, rewards are in its range, and a reset gives 0."""
    signature = environment.signature
    steps = _played(environment, 7)
    low, high = signature.reward_range
    for step in steps:
        for field in ("observation", "achieved_goal", "desired_goal"):
            demand_shape(getattr(step, field), (getattr(signature, field).size,), field, np.float32)
        demand(low <= step.reward <= high, f"the reward {step.reward} is outside {signature.reward_range}")
    demand(steps[0].reward == 0, f"a reset gives the reward {steps[0].reward} instead of 0")
    demand(not steps[0].terminated and not steps[0].truncated, "a reset ends its episode")
    count, most = len(steps) - 1, signature.max_steps
    demand(count <= most, f"an episode has {count} steps, more than max_steps {most}")
    demand_shape(environment.parameters(), (signature.parameters.size,), "the result of parameters()")
    measures = environment.measures()
    demand_shape(measures, (len(signature.measures),), "the result of measures()", np.float32)
    demand(not np.isinf(measures).any(), f"a measure is infinite, not nan: {measures}")


@PROMISES
def an_episode_ends_once_and_no_step_follows(environment: Environment) -> None:
    """An episode is terminated or truncated, never both, and a step after its end raises RuntimeError."""
    steps = _played(environment, 8)
    ends = [bool(step.terminated or step.truncated) for step in steps]
    demand(ends[-1], f"the episode has not ended after {len(steps) - 1} steps")
    demand(not (steps[-1].terminated and steps[-1].truncated), "an episode is terminated and truncated at once")
    action = _actions(environment, 0, 1)[0]
    demand_refusal(lambda: environment.step(action), RuntimeError, "a step after the end raises no RuntimeError")


@PROMISES
def a_step_stays_as_it_was_returned(environment: Environment) -> None:
    """Later steps and resets do not change the arrays of an earlier step."""
    step = environment.reset(1)
    copies = Step(*map(np.copy, step))
    environment.step(_actions(environment, 1, 1)[0])
    environment.reset(2)
    demand_same_fields(copies, step, "a step before and after the next step")


@PROMISES
def the_goal_rule_gives_the_rewards_and_ends_of_the_steps(environment: Environment) -> None:
    """The goal rule, if there is one, gives success, termination and, but for its extra part, reward of every step."""
    rule, (low, high) = environment.signature.goal_rule, environment.signature.extra_reward
    if rule is None:
        return
    steps = _played(environment, 9)[1:]
    achieved, desired = (np.stack([step[column] for step in steps]) for column in (1, 2))
    rewards, ruled = np.array([step.reward for step in steps], np.float32), rule.reward(achieved, desired)
    allowed = np.clip(rewards, ruled + low, ruled + high)
    wrong = np.flatnonzero(~np.isclose(rewards, allowed, rtol=1e-4, atol=1e-5))  # goals may be computed as float64
    demand(not wrong.size, f"step {[int(step) + 1 for step in wrong[:1]]} has another reward than the rule's")
    demand_same(rule.success(achieved, desired), [step.success for step in steps], "the rule's success")
    demand_same(rule.terminated(achieved, desired), [step.terminated for step in steps], "the rule's termination")


@PROMISES
def the_goal_is_never_reached_at_the_start(environment: Environment) -> None:
    """The goal is not reached at the start of an episode."""
    solved = [seed for seed in range(STARTS) if environment.reset(seed).success]
    demand(not solved, f"{len(solved)} of {STARTS} seeds begin at their goal, e.g. {solved[:1]}")


@PROMISES
def closing_twice_is_safe(environment: Environment) -> None:
    """`close` may be called twice."""
    environment.reset(0)
    environment.close()


def _actions(environment: Environment, seed: int, count: int | None = None) -> FloatArray:
    generator = np.random.default_rng(seed)
    return random_actions(environment.signature, count or environment.signature.max_steps, generator)


def _played(environment: Environment, seed: int) -> list[Step]:
    """An episode of random actions, with its reset."""
    steps = [environment.reset(seed)]
    for action in _actions(environment, seed):
        steps.append(environment.step(action))
        if steps[-1].terminated or steps[-1].truncated:
            break
    return steps
