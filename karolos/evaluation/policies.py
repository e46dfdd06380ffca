"""Policies that act in one environment: a saved agent, a task's expert, random actions."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core import Agent, Deployed, Discrete, Environment, Signature, State, Step, random_actions
from ..core.seeding import SeedTree
from ..environments.build import Facts, build_environment, engine_of, used
from ..errors import MachineError, NoSuchRunError, UsageError, closest
from ..records import RunFolder, checkpoint, provenance
from ..records.evaluation import Evaluation
from ..records.shipped import POLICY, is_shipped
from ..specification import Spec, load_spec, spec_from_dict
from ..specification.files import SHIPPED, SPEC_SUFFIXES, find_spec, shipped_specs
from ..store.query import find_folder, index
from ..system.files import read_object

if TYPE_CHECKING:
    from ..environments.gymnasium.export import GoalEnv


@dataclass(frozen=True)
class Policy:
    """Chooses the action (a,) after a step."""

    act: Callable[[Step], NDArray[np.float32]]
    begin: Callable[[], None] = lambda: None
    """Is called after each reset."""


@dataclass(frozen=True)
class Learned:
    """The learned policy of a run."""

    run: str
    checkpoint: str
    sha256: str
    """SHA-256 of the agent's state in the checkpoint, in hexadecimal digits."""
    steps: int
    """Environment steps of its training."""
    seconds: float
    """Wall-clock seconds of collecting and learning of its training."""
    state: State | Deployed
    """The state; for a shipped run its policy."""

    def record(self) -> dict[str, object]:
        """Description for the events of a run that starts from it."""
        return {"run": self.run, "checkpoint": self.checkpoint, "sha256": self.sha256, "steps": self.steps}


@dataclass(frozen=True, repr=False)
class SavedAgent(Learned):
    """The agent of a checkpoint, on the CPU."""

    spec: Spec
    """The run's spec. Its engine may be missing here: see `playable`."""
    facts: Facts
    """Facts of the environment that the agent was trained in."""
    agent: Agent
    tested: Evaluation | None = None
    """Its final test, or the test at its steps."""

    @property
    def signature(self) -> Signature:
        """Signature of the environment that the agent was trained in."""
        return self.facts.signature

    def __repr__(self) -> str:
        """Two lines: run and success of the policy, and its inputs and outputs."""
        test, signature, good = self.tested, self.signature, "not tested"
        if test is not None:
            good = f"success {test.success_end:.2f}" if test.has_success else f"return {test.mean_return or 0:.2f}"
            good += f" in {test.episodes} test episodes"
        known = signature.action
        action = f"one of {len(known.labels)} actions" if isinstance(known, Discrete) else f"action {known.size}"
        whose = f"{self.spec.agent.name} of {self.run}, {self.checkpoint} after {self.steps:,} steps"
        sizes = f"observation {signature.observation.acting.size}, goal {signature.desired_goal.size}"
        return f"{whose}: {good}\n{self.spec.name}: {sizes} -> {action}"

    def environment(
        self, *, randomize: bool = False, render_mode: str | None = None, width: int = 640, height: int = 480
    ) -> GoalEnv:
        """The gymnasium environment that the agent was trained in, see `karolos.make`."""
        from ..environments.gymnasium.export import SpecEnv  # noqa: PLC0415  (imports gymnasium)

        return SpecEnv(self.spec, randomize=randomize, render_mode=render_mode, width=width, height=height)

    def act(self, observation: ArrayLike | Mapping[str, ArrayLike], goal: ArrayLike | None = None) -> NDArray[Any]:
        """The action for an observation and its desired goal, without exploration.

        An observation of one of karolos' gymnasium environments knows its environment. It is refused if layouts, rate
        or scale of actions differ from training. For other arrays only the size can be checked.

        Args:
            observation: (o,), or (n, o) for n actions, with or without the columns that only critics observe; or the
                dict of a gymnasium environment, which holds the goal, too.
            goal: (g,) or (n, g); may be left out if the environment has no goal.

        Returns:
            (a,) or (n, a), float32 in [-1, 1]; or the indices of discrete actions.

        Raises:
            UsageError: the observation does not fit the environment of the run, or a number is nan or infinite.
        """
        if isinstance(observation, Mapping):
            self._check_origin(observation)
            goal = observation.get("desired_goal") if goal is None else goal
            observation = observation["observation"]
        seen = np.asarray(observation, np.float32)
        if seen.shape[-1:] == (self.signature.observation.size,):
            seen = seen[..., : self.signature.observation.acting.size]
        ahead = seen.shape[:-1]
        wanted = np.zeros((*ahead, 0), np.float32) if goal is None else np.asarray(goal, np.float32)
        layouts = (self.signature.observation.acting, self.signature.desired_goal)
        for name, array, layout in zip(("observation", "goal"), (seen, wanted), layouts, strict=True):
            if len(ahead) > 1 or array.shape != (*ahead, layout.size):
                expected = f"({layout.size},) or (n, {layout.size})"
                raise UsageError(f"the {name} has the shape {array.shape}", where="act", hint=f"it must be {expected}")
            if not np.isfinite(array).all():
                column = int(np.argwhere(~np.isfinite(array))[0, -1])
                what = f"{name}[{column}], which is {layout.column(column)}, is not finite"
                raise UsageError(what, where="act", hint="stop the robot, and look at its sensor")
        actions = np.asarray(self.agent.act(np.atleast_2d(seen), np.atleast_2d(wanted), explore=False))
        return actions if ahead else actions[0]

    def _check_origin(self, observation: Mapping[str, Any]) -> None:
        """Raise UsageError if the policy does not fit the environment of an observation."""
        own = "karolos.load(...).environment() is what it was trained in"
        if differences := getattr(observation, "facts", self.facts).differences(self.facts):
            what = f"{self.run} was trained in another environment: " + "; ".join(differences)
            hint = f"{own}; act(observation['observation'], observation['desired_goal']) asks for sizes alone"
            raise UsageError(what, where="act", hint=hint)
        for name in ("observation", "desired_goal")[: 2 if self.signature.desired_goal.size else 1]:
            if name not in observation:
                raise UsageError(
                    f"the observation has no {name!r}, only {', '.join(observation)}", where="act", hint=own
                )

    def policy(self) -> Policy:
        """Acts without exploration."""
        act = self.agent.act
        return Policy(lambda step: np.asarray(act(step.observation[None], step.desired_goal[None], explore=False)[0]))


def read_learned(folder: RunFolder, name: str) -> Learned:
    """The content of a checkpoint. A shipped run has no checkpoints: the result is its policy, for each name.

    Raises RunError if the checkpoint is missing or damaged.
    """
    if is_shipped(folder):
        about: Mapping[str, Any] = read_object(folder.path / "policy.json") or {}
        policy = Deployed.read(folder.path / POLICY)
        known = (about["checkpoint"], about["sha256"], about["steps"])
        return Learned(folder.id, *known, folder.state().seconds, policy)
    state, meta, sha256 = checkpoint.load_part(folder.checkpoints, name, "agent")
    with checkpoint.fitting(f"{folder.id}, checkpoint {name}"):
        return Learned(folder.id, name, sha256, int(meta["steps"]), float(meta["seconds"]), state)


def spec_of(folder: RunFolder) -> Spec:
    """The run's resolved spec. Raises RunError if it is missing, damaged or changed."""
    return spec_from_dict(folder.spec())


def playable(spec: Spec) -> Spec:
    """The spec, with another engine if its own is not installed."""
    engine = engine_of(spec.environment)
    if engine is None or engine.installed:
        return spec
    return spec.having("environment", engine=engine.or_another().name)


def has_window(spec: Spec) -> bool:
    """Whether the spec's environment can be watched in a window."""
    engine = engine_of(spec.environment)
    return "window" in type(spec.environment.settings).model_fields and (engine is None or "window" in engine.abilities)


def load_agent(folder: RunFolder, name: str = "best") -> SavedAgent:
    """The agent of a run's checkpoint, `best` or `last`. Warns of files that were edited since the run began.

    A shipped run has one policy, for each name. Raises RunError if the checkpoint is missing, or if the checkpoint or
    the resolved spec is damaged.
    """
    spec, learned = spec_of(folder), read_learned(folder, name)
    if changed := provenance.edited(folder.description(), spec.files()):
        warnings.warn(f"{', '.join(changed)} was edited after {folder.id} was made: results may differ", stacklevel=2)
    with used(environment_of(playable(spec))) as environment:
        facts = Facts.of(environment)
    agent: Agent = spec.agent.make(facts.signature, SeedTree(0), "cpu")
    with checkpoint.fitting(f"{folder.id}, checkpoint {learned.checkpoint}"):
        if isinstance(learned.state, Deployed):
            agent.adopt(learned.state)
        else:
            agent.load_state(learned.state)
    tested = folder.final().get(learned.checkpoint)
    tested = tested or next((test for test in folder.tests() if test.steps == learned.steps), None)
    return SavedAgent(**vars(learned), spec=spec, facts=facts, agent=agent, tested=tested)


def load_run(
    run: str | Path, checkpoint: str = "best", *, runs: str | Path = "runs", database: str | None = None
) -> SavedAgent:
    """`karolos.load`: the policy of a run.

    Args:
        run: the path of a run folder; @last, an id or an experiment's name, as on the command line; or the name of a
            shipped policy, such as panda_pick.
        checkpoint: `best` or `last`.
        runs: the runs folder.
        database: URL of the database; by default the one in the runs folder.

    Raises:
        UsageError: `run` means no run, or several; or there is no such runs folder.
        RunError: the checkpoint is missing or damaged.
    """
    with index(runs, database) as store:
        return load_agent(find_folder(str(run), store, runs), checkpoint)


def make(
    what: str | Path | Spec | Mapping[str, Any],
    *,
    randomize: bool = False,
    render_mode: str | None = None,
    width: int = 640,
    height: int = 480,
    runs: str | Path = "runs",
    database: str | None = None,
) -> GoalEnv:
    """The gymnasium environment that a spec describes, with all its settings.

    Args:
        what: a spec file, the name of a shipped spec such as panda_push, a run as in `karolos.load`, a Spec, or a
            dictionary. A file comes first, then a shipped spec, then a run. `shipped:panda_push` means the shipped run.
        randomize: whether to sample the spec's `randomization` at each reset, as in training. Tests do not.
        render_mode: None, "rgb_array", or "human": a window, if the engine has one.
        width: of a picture in pixels.
        height: of a picture in pixels.
        runs: the runs folder.
        database: URL of the database; by default the one in the runs folder.

    Raises:
        SpecError: the spec is invalid.
        UsageError: there is neither such a spec nor such a run, the environment has no goals, or its engine is not
            installed.
        RunError: the run is damaged.
    """
    from ..environments.gymnasium.export import SpecEnv  # noqa: PLC0415  (imports gymnasium)

    if isinstance(what, Mapping):
        what = spec_from_dict(what)
    spec = what if isinstance(what, Spec) else _meant_spec(str(what), runs, database)
    return SpecEnv(spec, randomize=randomize, render_mode=render_mode, width=width, height=height)


def _meant_spec(what: str, runs: str | Path, database: str | None) -> Spec:
    if find_spec(what)[0].is_file() or what.startswith(SHIPPED) or what.endswith(SPEC_SUFFIXES):
        return load_spec(what)
    with index(runs, database) as store:
        try:
            return spec_of(find_folder(what, store, runs))
        except NoSuchRunError as error:
            like = closest(what, shipped_specs())
            hint = f"did you mean {like!r}, a shipped spec?" if like else error.hint
            raise NoSuchRunError(f"{what!r} is neither a spec nor a run", hint=hint) from error


def signature_of(spec: Spec, *, randomize: bool = False) -> Signature:
    """The signature of the spec's environment. A robot's world is not simulated."""
    with used(environment_of(spec, randomize=randomize)) as environment:
        return environment.signature


def expert_policy(environment: Environment) -> Policy:
    """The scripted expert of the environment's task. Raises UsageError if there is none."""
    expert = environment.expert()
    return Policy(lambda _: np.asarray(expert.act(), np.float32), expert.reset)


def random_policy(environment: Environment, seed: int) -> Policy:
    """Uniformly random actions from a separate generator under `seed`."""
    generator = SeedTree(seed).child("random policy").generator()
    return Policy(lambda _: np.asarray(random_actions(environment.signature, 1, generator)[0]))


def environment_of(spec: Spec, *, randomize: bool = False, window: bool = False) -> Environment:
    """One environment of the spec, with its randomization or without.

    Raises MachineError if there is no display for the window.
    """
    recipe = spec.recipe(randomize=randomize)
    if window:
        part = recipe.environment
        if "window" not in type(part.settings).model_fields:
            raise MachineError(f"environment {part.name} has no window", hint="record a film with --out FILE.mp4")
        settings = part.settings.model_copy(update={"window": True})
        recipe = replace(recipe, environment=replace(part, settings=settings))
    return build_environment(recipe)
