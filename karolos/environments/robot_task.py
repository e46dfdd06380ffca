"""A robot with a task: the environment that joins the two."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import hypot, isfinite
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import Array, Environment, Expert, FloatArray, GoalRule, Layout, Measure, SeedTree, Signature, Step
from ..core import Settings as BaseSettings
from ..core.environment import STAGE
from ..errors import PluginError, UsageError
from ..simulation.engines import ENGINES, Engine, make_world
from ..simulation.geometry import rotated
from ..simulation.interface import PHYSICS_RATE, Camera, Robot, Stroke, Task, TaskNeeds, World
from .action_set import ActionSet, action_index
from .distributions import Distribution
from .randomization import Randomization

TIME_TO_SUCCESS = Measure(
    "time_to_success", "s", "smaller", "time from which on the goal is reached until the end; undefined in a failure"
)
FINAL_ANGLE = Measure("final_angle", "rad", "smaller", "angle to the goal's orientation at the end of the episode")
FORCE_COLOUR = (0.84, 0.1, 0.5, 1.0)
LONGEST_AGE = 0.15
"""s; the largest latency and jitter of a robot, together."""
LEAST_SHOWN, LONGEST_SHOWN, LENGTH_OF_FORCE = 1.0, 20.0, 0.25
"""Smallest force with an arrow in a picture and force with the longest arrow, in N; length of the longest arrow as a
fraction of the camera's distance."""

USUAL_REACH = 0.5
"""Way in m from the base to the tool at home of the arms that a camera shows whole."""
WRIST = Camera(distance=0.3, yaw=-90.0, pitch=-55.0, field_of_view=60.0)
"""Camera behind and above the tool, which is its target. It moves with the tool, without turning."""


class RobotTask(Environment):
    """Any robot with any task. Neither knows the other. The physics world is built at the first reset.

    Observation: the robot's part, then the task's.
    Action: the robot's, each number in [-1, 1]; with `actions: discrete` one of an `ActionSet`.
    Reward, success, termination: by the task's goal rule; the episode is truncated after the task's `max_steps`, or,
    without success, by a protective stop of the robot.
    Measures: time to success, distance and angle to the goal if its rule has them, then the robot's and the task's.

    Raises:
        PluginError: robot and task declare a measure of one name; while it runs, the task observes what is not finite,
            or gives an `extra_reward` beyond its range.
        UsageError: robot and task are incompatible, `omit` names an unknown field, or the engine is not installed.
    """

    class Settings(BaseSettings):
        engine: Engine = Setting("mujoco", description="physics engine")
        substeps: int = Setting(10, ge=1, le=100, description="length of a control step in 1/240 s; 10 make 24 Hz")
        physics_rate: Literal[240, 480, 720, 960] = Setting(
            PHYSICS_RATE,
            description="physics steps per second; computing time is proportional, the motion hardly changes",
        )
        actions: Literal["continuous", "discrete"] = Setting(
            "continuous", description="discrete: one full step along each action axis in both directions, or no motion"
        )
        omit: tuple[str, ...] = Setting(
            (), description="fields to leave out of the observation, e.g. [object_velocity]"
        )
        critic_observes: tuple[str, ...] = Setting((), description="fields of the task that only the critics observe")
        window: bool = Setting(False, description="show the world in a window; needs a display")

        def identity(self) -> dict[str, Any]:
            """The settings that change results."""
            return self.model_dump(mode="json", exclude={"window"})

    def __init__(self, settings: RobotTask.Settings, *, robot: Robot, task: Task) -> None:
        ENGINES[settings.engine].check({"environment.window": "window"} if settings.window else {})
        self.settings = settings
        self.robot = robot
        self.task = task
        self.rate = PHYSICS_RATE / settings.substeps
        self.divergences = 0
        """Number of episodes truncated because the physics diverged."""
        period = settings.substeps / PHYSICS_RATE
        robot.prepare(TaskNeeds(task.uses_gripper, period, task.control, task.protective_stop, task.fingers))
        ENGINES[settings.engine].check({**robot.engine_needs, **task.engine_needs})
        task.fit(robot)
        blind = {"calibration_error"} if not task.observation.size else set()  # cameras have nothing to film
        self.declared = {
            **{f"robot.{name}": parameter for name, parameter in robot.parameters.items() if name not in blind},
            **{f"task.{name}": parameter for name, parameter in task.parameters.items()},
        }
        """The parameters that randomization may change, by name with the part in front."""
        self._action_set = ActionSet(robot.action) if settings.actions == "discrete" else None
        self._terminates = type(task.goal_rule).terminated is not GoalRule.terminated
        self._sparse = task.goal_rule.sparse
        self._drawn: list[float] = []
        full = robot.observation + task.observation
        kept = tuple(field for field in full.fields if field.name not in settings.omit)
        offered = {field.name: field for field in task.critic_only.fields}
        if unknown := sorted(set(settings.critic_observes) - set(offered)):
            raise UsageError(
                f"the task has no field {', '.join(unknown)} that only critics observe",
                setting="environment.critic_observes",
                hint=f"it has {', '.join(offered) or 'nothing'}",
            )
        hidden = dict.fromkeys(settings.critic_observes)
        places = range(task.critic_only.size)
        self._critic_columns = [column for name in hidden for column in places[task.critic_only.slice(name)]]
        only = tuple(replace(offered[name], critic_only=True) for name in hidden)
        if unknown := sorted(set(settings.omit) - set(full.names)):
            raise UsageError(
                f"no observation is called {', '.join(unknown)}",
                setting="environment.omit",
                hint=f"there are {', '.join(full.names)}",
            )
        if not kept:
            raise UsageError("nothing would be observed", setting="environment.omit", hint="leave out less")
        self._feels = any("wrench" in field.name for field in full.fields)
        self._columns: NDArray[np.intp] | None = None
        """Columns of the full observation that are kept; None: all."""
        if settings.omit:
            self._columns = np.concatenate([np.arange(full.size)[full.slice(field.name)] for field in kept])
        (low, high), extra = task.goal_rule.reward_range, task.extra_reward_range
        self.signature = Signature(
            observation=Layout(kept + only),
            action=self._action_set.actions if self._action_set else robot.action,
            max_steps=task.max_steps,
            reward_range=(low + extra[0], high + extra[1]),
            extra_reward=extra,
            achieved_goal=task.achieved_goal,
            desired_goal=task.desired_goal,
            goal_rule=task.goal_rule,
            measures=self._measures(),
        )
        self._has_extra_reward = type(task).extra_reward is not Task.extra_reward
        self.randomize({})
        self._name = f"{type(robot).__name__}{type(task).__name__}"
        self._shape = (robot.action.size,)
        self._world: World | None = None
        self._steps = task.max_steps  # no episode is running
        self._last: Step | None = None
        self._latency = self._jitter = 0.0
        self._before: deque[list[float]] = deque(maxlen=round(LONGEST_AGE * self.rate) + 2)
        """Observations of the last control steps, newest first, if observations are delayed."""
        self._reached: int | None = None
        """Step since which the goal is reached; None if it is not reached."""

    def _measures(self) -> tuple[Measure, ...]:
        rule, task = type(self.task.goal_rule), self.task
        measures = [TIME_TO_SUCCESS]
        if rule.distance is not GoalRule.distance:
            measures.append(task.distance_measure)
        if rule.angle is not GoalRule.angle:
            measures.append(FINAL_ANGLE)
        measures += [*self.robot.measures, *task.measures]
        names = [measure.name for measure in measures]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            what = f"the measures {', '.join(twice)} are declared twice"
            raise PluginError(what, where=type(task).__name__, hint="give those of the task other names")
        return tuple(measures)

    def randomize(self, distributions: Mapping[str, Distribution]) -> None:
        """Set the parameters that each reset samples ("task.gravity"). Raises UsageError for undeclared ones."""
        self._randomization = Randomization(distributions, self.declared)
        names = self._randomization.layout.names
        self._stages = {name.removeprefix(STAGE): k for k, name in enumerate(names) if name.startswith(STAGE)}
        """Stage -> column of its probability among the parameters."""
        self.signature = replace(self.signature, parameters=self._randomization.layout)

    @property
    def camera(self) -> Camera:
        """Camera of pictures: the task's, moved with the robot's base."""
        x, y, z = (own + base for own, base in zip(self.task.camera.target, self.robot.base, strict=True))
        return replace(self.task.camera, target=(x, y, z), base=self.robot.base)

    @property
    def world(self) -> World:
        """The physics world, built at the first access."""
        if self._world is None:
            self._world = make_world(
                self.settings.engine,
                substeps=self.settings.substeps * self.settings.physics_rate // PHYSICS_RATE,
                rate=self.settings.physics_rate,
                window=self.settings.window,
                camera=self.camera,
            )
            self.robot.build(self._world)
            self.task.build(self._world)
        return self._world

    def reset(self, seed: int) -> Step:
        world = self.world
        if self._randomization.layout.size:
            # a separate generator: an episode has the same start and goal with and without randomization
            self._drawn = self._randomization.draw(SeedTree(seed).child("randomization").generator())
        for name, value in zip(self._randomization.layout.names, self._drawn, strict=True):
            part, _, parameter = name.partition(".")
            if part == "robot":
                self.robot.apply(parameter, value)
                self._latency = value if parameter == "latency" else self._latency
                self._jitter = value if parameter == "jitter" else self._jitter
            else:
                self.task.apply(world, parameter, value)
        self._generator = generator = np.random.Generator(np.random.PCG64(seed))
        self._before.clear()
        self.robot.reset(generator)
        world.forget_contacts()
        self.task.reset(generator)
        if self._action_set is not None:
            self._action_set.reset(self.robot.opening_command)
        self._steps = 0
        observation = self._observation()
        if observation is None:
            return self._diverged()
        achieved, goal = self.task.achieved(), self.task.goal
        success = bool(self.task.goal_rule.success(achieved, goal))
        self._reached = 0 if success else None
        self._last = Step(observation, achieved, goal, 0.0, False, False, success)
        return self._last

    def step(self, action: Array) -> Step:
        """One control step.

        Raises:
            ValueError: an action of a wrong shape, with NaN, or not in the action set.
            RuntimeError: the episode is over, or the environment closed.
        """
        self.robot.act(self._checked(action))
        self.world.step()
        self.robot.read()
        self.task.read()
        self._steps += 1
        observation = self._observation()
        if observation is None:
            return self._diverged()
        rule, achieved, goal = self.task.goal_rule, self.task.achieved(), self.task.goal
        terminated = self._terminates and bool(rule.terminated(achieved, goal))
        stopped = self.robot.stopped
        over = stopped or self._steps >= self.signature.max_steps or self.task.over()
        truncated = over and not terminated
        near = bool(rule.success(achieved, goal))
        reward, success = near - 1.0 if self._sparse else float(rule.reward(achieved, goal)), near and not stopped
        if not success:
            self._reached = None
        elif self._reached is None:
            self._reached = self._steps
        if terminated or truncated:
            self._steps = self.signature.max_steps
        if self._has_extra_reward:
            reward += self._extra_reward()
        self._last = Step(observation, achieved, goal, reward, terminated, truncated, success)
        return self._last

    def _extra_reward(self) -> float:
        """The part of the reward that does not depend on the goal. Raises PluginError if it leaves its range."""
        extra, (low, high) = float(self.task.extra_reward()), self.signature.extra_reward
        if not low - 1e-4 <= extra <= high + 1e-4:
            what = f"extra_reward gives {extra:g}, outside extra_reward_range, which is ({low:g}, {high:g})"
            hint = "declare the whole range, because learned values and hindsight are limited to it"
            raise PluginError(what, where=type(self.task).__name__, hint=hint)
        return extra

    def _checked(self, action: Array) -> list[float]:
        """The robot's action."""
        action = np.asarray(action)
        if self._steps >= self.signature.max_steps:
            raise RuntimeError(f"{self._name}: the episode is over; reset the environment first")
        if self._action_set is not None:
            return self._action_set.values(action_index(action, self._action_set.actions, self._name))
        if action.shape != self._shape:
            raise ValueError(f"{self._name}: an action has the shape {self._shape}, not {action.shape}")
        values: list[float] = action.tolist()
        if not isfinite(sum(values)):
            raise ValueError(f"{self._name}: an action must be finite, not {values}")
        return values

    def _observation(self) -> FloatArray | None:
        """The robot's part and the task's; None if the physics diverged."""
        values = [*self.robot.observe(), *self.task.observe()]
        if not isfinite(sum(values)) or self.task.lost():
            return None
        if self._latency or self._jitter:
            values = self._late(values)
        observed = np.array(values, np.float32)
        if self._columns is not None:
            observed = observed[self._columns]
        if not self._critic_columns:
            return observed
        hidden = np.array(self.task.observe_for_critics(), np.float32)[self._critic_columns]
        return np.concatenate((observed, hidden)) if np.isfinite(hidden).all() else None

    def _late(self, values: list[float]) -> list[float]:
        """The observation from before this episode's latency, interpolated linearly between control steps."""
        before = self._before
        before.appendleft(values)
        age = self._latency + (float(self._generator.uniform(0.0, self._jitter)) if self._jitter else 0.0)
        whole, share = divmod(age * self.rate, 1.0)
        newer, older = (before[min(int(whole) + place, len(before) - 1)] for place in (0, 1))
        return [new + share * (old - new) for new, old in zip(newer, older, strict=True)]

    def _diverged(self) -> Step:
        """End the episode with the last finite state. The next reset builds a new world."""
        name = self._not_finite() if self._last is None else None
        self.divergences += 1
        self._steps = self.signature.max_steps
        self.close()
        if name is not None:
            hint = "check how it is computed, and where `reset` places things"
            raise PluginError(f"observes {name}, which is not finite", where=type(self.task).__name__, hint=hint)
        if self._last is None:
            raise RuntimeError(f"{self._name}: the physics diverged before the first step")
        return self._last._replace(reward=0.0, terminated=False, truncated=True, success=False, diverged=True)

    def _not_finite(self) -> str | None:
        """The task's first field that is not finite; None if the robot's are not, either: the physics diverged."""
        if not isfinite(sum(self.robot.observe())):
            return None
        task, seen = self.task, self.task.observe()
        fields = {name: seen[task.observation.slice(name)] for name in task.observation.names}
        if self._critic_columns:
            hidden = task.observe_for_critics()
            fields |= {name: hidden[task.critic_only.slice(name)] for name in self.settings.critic_observes}
        return next((name for name, values in fields.items() if not isfinite(sum(values))), None)

    def expert(self) -> Expert:
        """The task's scripted policy. Raises UsageError for a task without one, or discrete actions."""
        if self._action_set is not None:
            raise UsageError(
                "experts give continuous actions, and this environment takes discrete ones",
                setting="environment.actions",
                hint="set environment.actions=continuous",
            )
        _ = self.world  # an expert needs the world
        expert = self.task.expert()
        if expert is None:
            raise UsageError(f"there is no expert for {self._name}", setting="task")
        return expert

    def parameters(self) -> FloatArray:
        """The sampled values; for the probability of a stage 1 if the episode began in it, else 0."""
        drawn = np.array(self._drawn, np.float32)
        for stage, column in self._stages.items():
            drawn[column] = stage == self.task.stage
        return drawn

    def measures(self) -> FloatArray:
        values: dict[str, Any] = {}
        if self._last is not None and self._world is not None:  # it is closed if the physics diverged
            rule, goals = self.task.goal_rule, (self._last.achieved_goal, self._last.desired_goal)
            values = {self.task.distance_measure.name: rule.distance(*goals), FINAL_ANGLE.name: rule.angle(*goals)}
            if self._reached is not None:
                values[TIME_TO_SUCCESS.name] = self._reached / self.rate
            values |= self.robot.measure() | self.task.measure()
        found = np.array([values.get(measure.name) for measure in self.signature.measures], np.float32)
        found[~np.isfinite(found)] = np.nan
        return found

    def render(self, width: int = 640, height: int = 480) -> Array:
        """The world with the task's markers, and the force at the tool if robot or task observe the wrench."""
        [picture] = self.film(1, width, height)
        return picture

    def portrait(self, width: int, height: int) -> Array:
        """A picture of the robot at its place, the same for every task. A large arm is seen from further away."""
        view = Camera()
        (x, y, _), (dx, dy, _) = self.robot.base, np.subtract(self.robot.tool.position, self.robot.base).tolist()
        scale = max(1.0, hypot(dx, dy) / USUAL_REACH)
        target = x + 0.66 * dx, y + 0.66 * dy, scale * view.target[2]
        view = replace(view, target=target, distance=scale * view.distance, base=self.robot.base)
        return self.world.render(width, height, view)

    def film(self, pictures: int, width: int = 640, height: int = 480) -> Iterator[Array]:
        strokes = [*self.task.strokes(), *self._force()]
        for left in range(pictures - 1, -1, -1):
            yield self.world.render(width, height, self.camera, strokes, left / pictures)

    def _force(self) -> Iterator[Stroke]:
        """An arrow from the tool along the force on it."""
        if not self._feels or self._world is None:
            return
        force = rotated(self.robot.tool.orientation, self.robot.wrench[:3])
        newtons = hypot(*force)
        if newtons >= LEAST_SHOWN:
            metres = self.camera.distance * LENGTH_OF_FORCE / max(newtons, LONGEST_SHOWN)
            start = self.robot.tool.position
            x, y, z = (own + metres * part for own, part in zip(start, force, strict=True))
            yield Stroke((start, (x, y, z)), FORCE_COLOUR, width=2.0, label=f"{newtons:.0f} N")

    def close(self) -> None:
        self._steps = self.signature.max_steps  # no episode is running
        if self._world is not None:
            self._world.close()
            self._world = None
