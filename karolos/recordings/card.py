"""README.md of a dataset: its content, success and origin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from statistics import fmean
from typing import Any

from ..statistics.intervals import wilson
from .recording import Played, column_names


def outcome(played: Sequence[Played]) -> dict[str, Any]:
    """Number of episodes that were played, kept and successful."""
    successes = sum(one.success for one in played)
    low, high = wilson(successes, len(played))
    means = {}
    for name in sorted({name for one in played for name in one.measures}):
        means[name] = fmean(one.measures[name] for one in played if name in one.measures)
    return {
        "played": len(played),
        "successes": successes,
        "success_interval": [low, high],
        "kept": sum(one.kept for one in played),
        "failed_and_left_out": sum(not (one.kept or one.diverged) for one in played),
        "diverged_and_left_out": sum(one.diverged for one in played),
        "measures": {name: mean for name, mean in means.items() if isfinite(mean)},
    }


def card(about: Mapping[str, Any]) -> str:
    """The text of README.md, with the front matter that the hub reads."""
    done, (low, high) = about["outcome"], about["outcome"]["success_interval"]
    lines = [
        "---",
        "license: other",
        "task_categories: [robotics]",
        "tags: [karolos, LeRobot, simulation]",
        "configs: [{config_name: default, data_files: data/*/*.parquet}]",
        "---",
        "",
        f"# {about['title']}",
        "",
        about["task"],
        "",
        "| what | value |",
        "|---|---|",
        f"| robot | {about['robot']} |",
        f"| policy | {about['policy']} |",
        f"| episodes | {done['kept']} of {done['played']} that were played |",
        f"| failed and left out | {done['failed_and_left_out']} |",
        f"| diverged and left out | {done['diverged_and_left_out']} |",
        f"| success of what was played | {done['successes'] / done['played']:.3f} (95 %: {low:.3f} to {high:.3f}) |",
        f"| steps per second | {about['rate']:g} |",
        f"| noise on actions | {about['noise']:g}, random {about['random']:g} |",
        f"| seed | {about['seed']} |",
        *(f"| {name}, mean | {value:.4g} |" for name, value in done["measures"].items()),
        *(f"| {name} | {version} |" for name, version in about["versions"].items()),
        f"| commit | {about['commit']} |",
        "",
        "| column | numbers |",
        "|---|---|",
    ]
    for part in ("observation", "achieved_goal", "desired_goal", "action"):
        fields = about[part]
        units = [f"{one['name']} ({one['unit']})" for one in fields] if isinstance(fields, list) else fields["labels"]
        lines.append(f"| {part} ({len(column_names(fields))}) | {', '.join(units)} |")
    return "\n".join(lines) + "\n"
