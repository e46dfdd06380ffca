"""`karolos-deploy BUNDLE --driver NAME`: checks a bundle and shows its actions; with --move it moves the robot."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .bundle import Bundle, BundleError
from .drivers import find
from .executor import Executor, Outcome, replay
from .faults import Fault

REFUSED, STOPPED = 2, 3
"""Exit codes: nothing was moved; the robot was stopped."""
SHOWN = 12
"""Number of actions that the dry run shows."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="karolos-deploy", description="Run a karolos bundle on a robot.")
    parser.add_argument("bundle", type=Path, help="folder that `karolos export RUN --bundle` wrote")
    parser.add_argument("--driver", default="simulation", help="simulation, ur, franka, or one that a package installs")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of the driver")
    parser.add_argument("--move", action="store_true", help="move the robot; otherwise actions are only shown")
    parser.add_argument("--rate", type=float, default=None, help="set points per second (default: 240, ur 500)")
    parser.add_argument("--episodes", type=int, default=1)
    parser.add_argument("--goal", help="numbers of the goal, separated by commas, see the page of the bundle")
    parser.add_argument("--log", type=Path, help="file to write every cycle to")
    parser.add_argument("--replay", type=Path, metavar="LOG", help="compute the set points of a log again, and compare")
    parser.add_argument("--onnx", action="store_true", help="let onnxruntime run the policy instead of numpy")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of lines")
    given = parser.parse_args(arguments)
    names = (getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP"))  # also if the terminal is closed
    asked = {one: signal.getsignal(one) for one in names if one is not None}
    for one, before in asked.items():
        if before is not signal.SIG_IGN:  # as nohup says
            signal.signal(one, signal.default_int_handler)  # as Ctrl-C: the robot is stopped
    try:
        code = _run(given)
        sys.stdout.flush()
        return code
    except BundleError as error:
        print(f"refused: {error}", file=sys.stderr)
        return REFUSED
    except Fault as fault:
        print(f"stopped: {fault}", file=sys.stderr)
        return STOPPED
    except KeyboardInterrupt:
        print("stopped: you asked for it", file=sys.stderr)
        return STOPPED
    except BrokenPipeError:  # `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what Python still writes at its end
        print("stopped: nobody reads the output", file=sys.stderr)
        return STOPPED
    finally:
        for one, before in asked.items():
            signal.signal(one, before)


def _run(given: argparse.Namespace) -> int:
    if given.episodes < 1:
        raise BundleError(f"--episodes {given.episodes}: at least 1")
    bundle = Bundle(given.bundle, onnx=given.onnx)
    if given.replay is not None:
        cycles, error = replay(bundle, given.replay)
        print(f"{cycles} cycles: set points differ by {error:.2g} at the most")
        return 0
    steps = bundle.replay_episode()
    if not given.json:
        print(f"{bundle.contract['run']['id']}: files whole; {steps} logged steps give the recorded actions")
    try:
        settings = dict(one.split("=", 1) for one in given.set)
        goal = [float(one) for one in given.goal.split(",")] if given.goal else None
    except ValueError:
        raise BundleError("--set takes NAME=VALUE, and --goal numbers separated by commas") from None
    driver = find(given.driver)(bundle, settings)
    rate = given.rate if given.rate is not None else (500 if given.driver == "ur" else 240)
    executor = Executor(bundle, driver, rate=rate, log=given.log)
    outcomes = []
    try:
        executor.check()
        if not given.move:
            shown = executor.run(0, goal, move=False, steps=SHOWN)
            for action in shown.actions:
                print(" ".join(f"{value:+.2f}" for value in action))
            print("nothing was moved; --move moves the robot")
            return 0
        for episode in range(given.episodes):
            outcome = executor.run(episode, goal)
            outcomes.append(outcome)
            if not given.json:
                ended = {True: "success", False: "no success", None: "over"}[outcome.success]
                print(f"episode {episode}: {ended}, {outcome.steps} steps, cycle p99 {1000 * outcome.slowest:.2f} ms")
    finally:
        driver.close()
        known = [outcome.success for outcome in outcomes if outcome.success is not None]  # also before a fault
        if given.json and outcomes:
            print(json.dumps(_told(outcomes, known, rate)))
        elif known:
            print(f"success {sum(known)} of {len(known)}")
    return 0


def _told(outcomes: Sequence[Outcome], known: Sequence[bool], rate: float) -> dict[str, Any]:
    """Episodes, successes where the bundle can tell, and seconds that cycles took."""
    spent = np.concatenate([outcome.cycles for outcome in outcomes])
    slow = {
        "p50": float(np.quantile(spent, 0.5)),
        "p99": float(np.quantile(spent, 0.99)),
        "most": float(spent.max()),
    }
    return {"episodes": len(outcomes), "successes": sum(known) if known else None, "rate": rate, "cycle": slow}


if __name__ == "__main__":
    sys.exit(main())
