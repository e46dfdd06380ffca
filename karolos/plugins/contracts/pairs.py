"""Promises of every robot with every task."""

from __future__ import annotations

from statistics import fmean

import numpy as np

from ...core import random_actions
from ...core.environment import STAGE
from ...environments.robot_task import RobotTask
from ...evaluation.playing import evaluate
from ...evaluation.policies import expert_policy, random_policy
from .case import Candidate, Promises, demand, demand_same
from .joined import joined, refusal

EPISODES, CHANCE_EPISODES = 10, 4
REFUSED, PROMISES, IN_REACH = Promises(), Promises(), Promises()
ARM_IN_REACH, EXPERT = Promises(), Promises()
"""Gravity may not move a robot that is not an arm, and a task may have no expert."""


@REFUSED
def the_task_refuses_the_robot(robot: Candidate, task: Candidate) -> None:
    """The task says why the robot cannot do it (e.g. too slow to throw) before anything is simulated."""
    demand(refusal(robot, task), "the task refuses the robot without a reason")


@EXPERT
def the_expert_solves_the_pair(robot: Candidate, task: Candidate) -> None:
    """The expert succeeds in at least 70 % of the episodes, and they define every measure."""
    with joined(robot, task) as environment:
        expert = evaluate(environment, expert_policy(environment), episodes=EPISODES, seed=1)
        demand(environment.divergences == 0, f"the simulation diverges in {environment.divergences} episodes")
    undefined = [name for name, one in expert.measures.items() if one["mean"] is None]
    demand(not undefined, f"measures that no episode of the expert defines: {', '.join(undefined)}")
    solved = fmean(expert.end)
    demand(solved >= 0.7, f"the expert succeeds in only {solved:.0%} of {EPISODES} episodes")


@PROMISES
def random_actions_do_not_solve_the_pair(robot: Candidate, task: Candidate) -> None:
    """Random actions succeed in at most 30 % of the episodes."""
    with joined(robot, task) as environment:
        chance = evaluate(environment, random_policy(environment, 1), episodes=CHANCE_EPISODES, seed=1)
        demand(environment.divergences == 0, f"the simulation diverges in {environment.divergences} episodes")
    lucky = fmean(chance.end)
    demand(lucky <= 0.3, f"random actions succeed in {lucky:.0%} of {CHANCE_EPISODES} episodes")


@PROMISES
def drawing_the_nominal_values_changes_nothing(robot: Candidate, task: Candidate) -> None:
    """Randomization that samples every nominal value gives the episodes of the plain environment."""
    with joined(robot, task) as plain:
        nominal = {name: value for name, (value, _, _) in _declared(plain).items()}
        with joined(robot, task, drawn=nominal) as drawn:
            for seed in range(2):
                demand_same(plain.reset(seed).observation, drawn.reset(seed).observation, "observations after a reset")
                for action in random_actions(plain.signature, 8, np.random.default_rng(seed)):
                    one, other = plain.step(action), drawn.step(action)
                    demand_same(one.observation, other.observation, "observations with every nominal value drawn")
                    demand(one.terminated == other.terminated, "an episode with every nominal value drawn ends apart")
                    if one.terminated:
                        break


@PROMISES
def extreme_values_of_every_parameter_can_be_drawn(robot: Candidate, task: Candidate) -> None:
    """The environment steps with all parameters at their lowest, or highest, values at once."""
    with joined(robot, task) as plain:
        declared = _declared(plain)
    for place in (1, 2):
        values = {name: bounds[place] for name, bounds in declared.items()}
        with joined(robot, task, drawn=values) as environment:
            environment.reset(0)
            # For the probability of a stage, parameters() says whether the episode began in the stage.
            drawn = dict(zip(sorted(values), environment.parameters().tolist(), strict=True))
            wrong = [
                f"{drawn[name]:g} for {name}, but {value:g} was drawn"
                for name, value in values.items()
                if not name.startswith(STAGE) and not np.isclose(drawn[name], value, rtol=1e-6)
            ]
            demand(not wrong, f"parameters() returns {', '.join(wrong)}")
            environment.step(np.ones(environment.signature.action.size, np.float32))


@ARM_IN_REACH
def every_parameter_changes_the_episodes_of_its_own_environment_alone(robot: Candidate, task: Candidate) -> None:
    """Each parameter changes the episodes of its own environment and of no other."""
    with joined(robot, task) as plain:
        nominal = _trace(plain, 3)
        for name, (usual, low, high) in _declared(plain).items():
            if name in {"task.floor_friction", "robot.joint_friction"}:  # nothing slides; motors have torque to spare
                continue
            with joined(robot, task, drawn={name: high if high != usual else low}) as changed:
                demand(_trace(changed, 3) != nominal, f"{name} changes nothing")
            demand(_trace(plain, 3) == nominal, f"{name} also changes another environment")


@IN_REACH
def the_expert_reaches_the_goal_at_both_ends_of_each_parameter(robot: Candidate, task: Candidate) -> None:
    """At both ends of each parameter the expert still succeeds in at least three of four episodes."""
    with joined(robot, task) as plain:
        declared = _declared(plain)
    for name, (usual, *ends) in declared.items():
        for value in ends:
            if value == usual:
                continue
            with joined(robot, task, drawn={name: value}) as environment:
                found = evaluate(environment, expert_policy(environment), episodes=4, seed=1).success_end or 0.0
            demand(found >= 0.75, f"with {name} = {value:g} the expert succeeds in only {found:.0%} of 4 episodes")


def _declared(environment: RobotTask) -> dict[str, tuple[float, float, float]]:
    """Parameters with nominal, lowest and highest value."""
    return {name: (one.nominal, one.low, one.high) for name, one in environment.declared.items()}


def _trace(environment: RobotTask, seed: int) -> bytes:
    """Observations and motor torques of up to 30 steps with random actions, of which the first 14 lower the arm."""
    seen = environment.reset(seed).observation.tobytes()
    actions = random_actions(environment.signature, 30, np.random.default_rng(0))
    actions[:14, 2] = -1.0
    for action in actions:
        after = environment.step(action)
        seen += after.observation.tobytes() + np.array(environment.robot.joint_torques).tobytes()
        if after.terminated or after.truncated:
            break
    return seen
