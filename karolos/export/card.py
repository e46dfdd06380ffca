"""README.md of an exported policy, with the front matter that the Hugging Face hub expects. Nothing is sent."""

from __future__ import annotations

import json
from pathlib import Path

from ..records import RunFolder
from ..system.files import write_whole


def write_card(folder: RunFolder, checkpoint: str, out: Path) -> Path:
    """Write README.md for an exported policy. Its figures are those of the final test, or of the last test.

    Raises:
        RunError: the run's spec is damaged.
        MachineError: the folder cannot be written.
    """
    spec, about, final = folder.spec(), folder.description(), folder.final()
    result = final.get(checkpoint) or final["last"] if final else None
    tests = folder.tests()
    result = result or (tests[-1] if tests else None)
    robot, task = (spec.get(key, {}).get("name") for key in ("robot", "task"))
    environment = f"{robot} {task}" if robot and task else spec["environment"]["name"]
    algorithm, title = spec["agent"]["name"].upper(), f"{spec['agent']['name'].upper()} on {environment}"
    metrics, lines = [], [f"{title}: not tested."]
    if result is not None:
        values = {"mean_reward": result.mean_return, "success_end": result.success_end}
        metrics = [
            {"type": name, "value": round(value, 4), "verified": False}
            for name, value in values.items()
            if value is not None
        ]
        lines = [f"Return {result.mean_return:.2f}" if result.mean_return is not None else "Return not finite"]
        if result.successes_end is not None:
            low, high = result.interval(result.successes_end)
            lines = [
                f"Success at the last step {result.success_end:.3f} (95 %: {low:.3f} to {high:.3f}), {lines[0].lower()}"
            ]
        chosen = "(held out)" if final else "in the last test; such tests select `best`"
        lines[0] += f", in {result.episodes} episodes {chosen}."
    kind = {"type": "reinforcement-learning", "name": "reinforcement-learning"}
    dataset = {"name": environment, "type": environment.replace(" ", "-")}
    index = [{"name": algorithm, "results": [{"task": kind, "dataset": dataset, "metrics": metrics}]}]
    front = {"library_name": "karolos", "tags": ["reinforcement-learning", "robotics", environment.replace(" ", "-")]}
    # JSON is YAML, and no value in JSON can end the front matter.
    header = "".join(f"{key}: {json.dumps(value)}\n" for key, value in {**front, "model-index": index}.items())
    git = about.get("git") or {}
    facts = {
        "run": f"{folder.id}, checkpoint {checkpoint}",
        "experiment": about["experiment"],
        "seed": about["seed"],
        "steps of training": f"{folder.state().steps:,}",
        "karolos": about.get("versions", {}).get("karolos"),
        "commit": git.get("commit"),
    }
    rows = "".join(f"| {name} | {value} |\n" for name, value in facts.items())
    text = f"---\n{header}---\n\n# {title}\n\n{lines[0]}\n\n| what | value |\n|---|---|\n{rows}\n"
    use = 'from karolos.export import NumpyPolicy\n\naction = NumpyPolicy("policy.npz")(observation, desired_goal)'
    path = out / "README.md"
    write_whole(path, f"{text}`policy.json` says what inputs and outputs mean.\n\n```python\n{use}\n```\n")
    return path
