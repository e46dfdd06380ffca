"""README.md of a dataset: its content, success and origin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .recording import column_names


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
        f"| success when played | {done['successes'] / done['played']:.3f} (95 %: {low:.3f} to {high:.3f}) |",
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
