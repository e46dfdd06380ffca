"""Environments that misbehave on command, in a module that worker processes can import."""

import os
import signal
import sys
import time

import numpy as np

from karolos.core import Discrete, Environment, Field, Layout, Measure, Signature, Step
from karolos.errors import KarolosError, PluginError

OBSERVATION = Layout(tuple(Field(name, 1) for name in ("pid", "steps", "torch", "blas_threads", "main_imported")))
FINE, RAISE, COMPLAIN, EXIT, DIE, HANG, PRINT, SEGFAULT = np.arange(8, dtype=np.float32)
QUIRKY, SLOW, INTERRUPT, END, NAN, HUGE, WORTHLESS, CUT = np.arange(8, 16, dtype=np.float32)


class QuirkyError(KarolosError):
    """A plugin's own error, which holds what no pickle can."""

    def __init__(self) -> None:
        super().__init__("quirky", hint="do not")
        self.callback = lambda: None


class Fake(Environment):
    """Does what the action says: step, raise, die ... `recipe` names the trouble to make while building, if any."""

    def __init__(self, recipe: str) -> None:
        if recipe == "raise":
            raise RuntimeError("no such device\nand a second line")
        if recipe == "complain":
            raise PluginError("the mesh is missing", where="robot.fake", hint="install it")
        if recipe == "die":
            os._exit(7)
        if recipe == "slow":
            time.sleep(0.5)
        if recipe == "hang":
            time.sleep(600)
        if recipe.startswith("/"):  # a file to note in that one more was built
            with open(recipe, "a") as file:
                file.write("built\n")
        self.signature = Signature(
            OBSERVATION,
            Discrete(tuple("0123456789")) if recipe == "discrete" else Layout((Field("trouble", 1),)),
            max_steps=100,
            parameters=Layout((Field("seed", 1), Field("half", 1))),
            measures=(Measure("steps", "1", "smaller", "of the episode"), Measure("never", "N", "larger", "undefined")),
        )
        self._recipe = recipe
        self._steps = 0
        self._seed = 0
        self._kept: list[np.ndarray] = []

    def reset(self, seed: int) -> Step:
        self._steps = 0
        self._seed = seed
        self._kept = []
        step = self._step()
        wrong = {"short": step.observation[:1], "nan": step.observation * np.nan}
        return step._replace(
            observation=wrong.get(self._recipe, step.observation), truncated=self._recipe == "over at once"
        )

    def step(self, action: np.ndarray) -> Step:
        if self._recipe == "discrete" and np.asarray(action).dtype.kind != "i":
            raise TypeError(f"{action!r} is no index")
        self._kept.append(action)
        trouble = np.asarray(action).reshape(-1)[0]
        self._steps += 1
        if trouble == RAISE:
            _fail_deep_inside()
        elif trouble == COMPLAIN:
            raise PluginError("the gripper has three fingers", where="robot.fake", hint="give it two")
        elif trouble == QUIRKY:
            raise QuirkyError
        elif trouble == EXIT:
            sys.exit("enough")
        elif trouble == DIE:
            os.kill(os.getpid(), signal.SIGKILL)
        elif trouble == SEGFAULT:
            os.kill(os.getpid(), signal.SIGSEGV)
        elif trouble == HANG:
            time.sleep(600)
        elif trouble == SLOW:
            time.sleep(0.1)
        elif trouble == INTERRUPT:
            raise KeyboardInterrupt
        elif trouble == PRINT:
            print("noise from an environment", flush=True)
        found = self._step()
        wrong = {NAN: {"observation": found.observation * np.nan}, WORTHLESS: {"reward": -np.inf}}
        wrong[CUT] = {"observation": found.observation[:1]}
        wrong[HUGE] = {"observation": found.observation.astype(float) + 1e300}  # which float32 cannot hold
        return found._replace(truncated=trouble == END, **wrong.get(trouble, {}))

    def parameters(self) -> np.ndarray:
        return np.array([self._seed, self._seed / 2], np.float32)

    def measures(self) -> np.ndarray:
        return np.array([self._steps, np.nan], np.float32)

    def _step(self) -> Step:
        threads = os.environ.get("OMP_NUM_THREADS", "0")
        main = hasattr(sys.modules["__main__"], "MARK_OF_THE_USERS_SCRIPT")
        numbers = (os.getpid(), self._steps, "torch" in sys.modules, int(threads), main)
        nothing = np.zeros(0, np.float32)
        return Step(np.array(numbers, np.float32), nothing, nothing, float(np.sum(self._kept)), False, False, False)


def _fail_deep_inside() -> None:
    raise ZeroDivisionError("the inertia is zero")


class Fickle(Fake):
    """Has another observation in each process."""

    def __init__(self, recipe: str) -> None:
        super().__init__(recipe)
        self.signature = Signature(
            Layout((Field(f"of_{os.getpid()}", 5),)), self.signature.action, 100, parameters=self.signature.parameters
        )
