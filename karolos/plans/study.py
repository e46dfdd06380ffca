"""Sampler, pruner and journal of a sweep. Only this module imports Optuna.

Only the main process accesses the study. The values of trial k depend on the sweep's seed, k and the earlier trials, so
interruptions do not change a sweep with one job at a time.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock
from optuna.trial import FrozenTrial, TrialState

from ..core.seeding import SeedTree
from ..records.sweep_records import SweepTrialState, Trial
from ..specification import Sweep
from ..specification.sweep import Direction

_STATES: dict[TrialState, SweepTrialState] = {
    TrialState.RUNNING: "running",
    TrialState.COMPLETE: "complete",
    TrialState.PRUNED: "pruned",
    TrialState.FAIL: "failed",
}
_RUNS, _ERROR = "runs", "error"
optuna.logging.set_verbosity(optuna.logging.ERROR)  # the sweep reports its own progress
warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)  # constraints.txt pins the version
STARTUP_TRIALS = 10
"""Number of first trials with random values. Later values depend on results."""
FEW_TRIALS = 4
"""Smallest number of different results for parameter importances."""


class _NoLock(JournalFileOpenLock):
    """Replaces Optuna's lock, which outlives a killed process. The lock of the sweep's folder is enough."""

    def acquire(self) -> bool:
        return True

    def release(self) -> None:
        pass


class OpenTrial:
    """An unfinished trial."""

    def __init__(self, trial: optuna.Trial, drawn: Mapping[str, Any]) -> None:
        self._trial = trial
        self.number = trial.number
        self.drawn = drawn

    def is_hopeless(self, value: float, step: int) -> bool:
        """Report the objective at a step, once; returns whether the pruner stops the trial."""
        if step not in self._trial.study.get_trials(deepcopy=False)[self.number].intermediate_values:
            self._trial.report(value, step)
        return self._trial.should_prune()

    def end(self, runs: Sequence[str] = (), values: Sequence[float] | None = None, error: str | None = None) -> None:
        """End the trial of these runs: complete with its objectives, failed with an error, or pruned without both."""
        self._trial.set_user_attr(_RUNS, list(runs))
        if error is not None:
            self._trial.set_user_attr(_ERROR, error)
        state = TrialState.FAIL if error is not None else TrialState.PRUNED if values is None else None
        self._trial.study.tell(self.number, None if values is None else list(values), state)


class Study:
    """The trials of a sweep, in its journal: a file that is created if it is missing.

    Trials are called `<name>-t000` and so on. `steps` is the training of each run, `directions` are those of the
    objectives.
    """

    def __init__(self, journal: Path, sweep: Sweep, name: str, steps: int, directions: tuple[Direction, ...]) -> None:
        self._sweep = sweep
        self._name = name
        self._directions = directions
        self._grid = list(sweep.combinations()) if sweep.sampler == "grid" else []
        pruner: optuna.pruners.BasePruner = optuna.pruners.NopPruner()
        if (asked := sweep.pruner) is not None:
            warmup = math.ceil(asked.warmup * steps)
            pruner = optuna.pruners.MedianPruner(n_startup_trials=asked.startup, n_warmup_steps=warmup)
        storage = JournalStorage(JournalFileBackend(str(journal), lock_obj=_NoLock(str(journal))))
        self._study = optuna.create_study(
            storage=storage,
            study_name=name,
            directions=self._directions,
            pruner=pruner,
            load_if_exists=True,
        )
        self._study.set_metric_names(list(sweep.objectives))  # for optuna-dashboard

    @staticmethod
    def draws(sweep: Sweep, count: int) -> list[dict[str, Any]]:
        """The values of the first `count` trials, at most STARTUP_TRIALS. None of them depends on results."""
        study, drawn = optuna.create_study(directions=["minimize"] * len(sweep.objectives)), []
        for number in range(count):
            study.sampler = _sampler(sweep, number)
            drawn.append(dict(_drawn(study.ask(), sweep).drawn))
        return drawn

    def trials(self) -> tuple[Trial, ...]:
        """All trials that have begun, by number."""
        return tuple(self._record(one) for one in self._all() if one.state in _STATES)

    def unfinished(self) -> list[OpenTrial]:
        """Trials to resume after an interruption. No other process runs them, because this one has the lock."""
        trials = []
        for one in self._all():
            if one.state == TrialState.RUNNING:
                self._study.sampler = _sampler(self._sweep, one.number)
                trials.append(_drawn(optuna.Trial(self._study, one._trial_id), self._sweep))
        return trials

    def ask(self) -> OpenTrial:
        """Sample one more trial; for a grid the next unused combination."""
        trials = self._all()
        waiting = any(one.state == TrialState.WAITING for one in trials)
        if self._grid and not waiting:
            self._study.enqueue_trial(self._grid[len(trials)])
        self._study.sampler = _sampler(self._sweep, len(trials) - waiting)
        return _drawn(self._study.ask(), self._sweep)

    def front(self) -> tuple[Trial, ...]:
        return tuple(self._record(one) for one in self._study.best_trials)

    def figures(self) -> dict[str, Any]:
        """Optuna's figures of the first objective: history, parallel, and importances if enough results differ.

        The importances are those of PED-ANOVA (Watanabe et al. 2023).
        """
        from optuna.visualization import matplotlib as drawing  # noqa: PLC0415  (takes half a second)

        complete = {one.values[0] for one in self._all() if one.state == TrialState.COMPLETE}
        of_first: dict[str, Any] = {"target_name": self._sweep.objectives[0]}
        if len(self._directions) > 1:
            of_first["target"] = lambda one: one.values[0]
        sign = -1 if self._directions[0] == "maximize" else 1  # with a target, PED-ANOVA minimises
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of targets, and of values that are equal in all trials
            drawn = {
                "history": drawing.plot_optimization_history(self._study, **of_first),
                "parallel": drawing.plot_parallel_coordinate(self._study, **of_first),
            }
            if len(complete) >= FEW_TRIALS:
                drawn["importances"] = drawing.plot_param_importances(
                    self._study,
                    evaluator=optuna.importance.PedAnovaImportanceEvaluator(),
                    target=lambda one: sign * one.values[0],
                )
        return {name: axes.figure for name, axes in drawn.items()}

    def _all(self) -> list[FrozenTrial]:
        return self._study.get_trials(deepcopy=False)

    def _record(self, one: FrozenTrial) -> Trial:
        return Trial(
            number=one.number,
            name=f"{self._name}-t{one.number:03}",
            state=_STATES[one.state],
            drawn=dict(one.params),
            values=tuple(one.values) if one.state == TrialState.COMPLETE else None,
            runs=tuple(one.user_attrs.get(_RUNS, ())),
            error=one.user_attrs.get(_ERROR),
        )


def _sampler(sweep: Sweep, number: int) -> optuna.samplers.BaseSampler:
    """The sampler of a trial, with a seed of its own."""
    seed = SeedTree(sweep.seed).child("sampler", number).integer() % 2**32
    if sweep.sampler == "gp":
        return optuna.samplers.GPSampler(seed=seed, n_startup_trials=STARTUP_TRIALS, warn_independent_sampling=False)
    if sweep.sampler == "tpe":
        conditional = any(parameter.when for parameter in sweep.space.values())
        # `group` samples settings with the same conditions together.
        return optuna.samplers.TPESampler(
            seed=seed, n_startup_trials=STARTUP_TRIALS, multivariate=True, group=conditional
        )
    return optuna.samplers.RandomSampler(seed=seed)


def _drawn(trial: optuna.Trial, sweep: Sweep) -> OpenTrial:
    """Sample every active parameter. A resumed trial gets its recorded values again."""
    drawn: dict[str, Any] = {}
    for key in sweep.order():
        parameter = sweep.space[key]
        if not sweep.is_active(key, drawn):
            continue
        if parameter.choice is not None:
            drawn[key] = trial.suggest_categorical(key, parameter.labels)
        elif parameter.int is not None:
            drawn[key] = trial.suggest_int(key, *parameter.int, log=parameter.log)
        else:
            drawn[key] = trial.suggest_float(key, *parameter.bounds, log=parameter.log)
    return OpenTrial(trial, drawn)
