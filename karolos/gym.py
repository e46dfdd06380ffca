"""Registers every robot with every task in gymnasium, as `karolos/<Robot><Task>-v1`.

    import gymnasium
    import karolos.gym

    gymnasium.make("karolos/UR5PickPlace-v2", control="cartesian", reward="sparse")

`gymnasium.make("karolos.gym:karolos/PandaReach-v1")` imports this module by itself. The names are those of the classes
of all installed plugins. Plugins and engines are imported when an environment is made. If a task's default number of
steps is too small for its expert, -v2 has more steps. -v1 stays unchanged, and gymnasium points to the newer one.
"""

from __future__ import annotations

import gymnasium

from .registry import entries

ENTRY_POINT = "karolos.environments.gymnasium.export:RobotTaskEnv"
VECTOR = "karolos.orchestrator.vector:robot_task_envs"
STEPS = {"pick_place": 75, "push": 75}
"""Control steps of an episode of -v2, by task. The Panda's expert needs up to 63; the tasks' own default is 50."""
_ACRONYMS = {"iiwa": "IIWA"}


def environment_ids() -> dict[str, tuple[str, str]]:
    """Robot and task behind each newest id, e.g. "karolos/PandaReach-v1": ("panda", "reach"). Imports no plugin."""
    robots, tasks = (_class_names(kind) for kind in ("robots", "tasks"))
    for needs_more in ("urdf", "random_arm"):  # a file, a number: `karolos.make` takes a spec that names one
        robots.pop(needs_more, None)
    return {
        f"karolos/{robot_class}{task_class}-v{2 if task in STEPS else 1}": (robot, task)
        for robot, robot_class in robots.items()
        for task, task_class in tasks.items()
    }


def _class_names(kind: str) -> dict[str, str]:
    """The class name of each plugin. If two are equal: the plugins' own names in capitalized words."""
    classes = {
        entry.name: _ACRONYMS.get(entry.name) or entry.target.partition(":")[2].rpartition(".")[2]
        for entry in entries(kind)
    }
    names = list(classes.values())
    return {
        plugin: name if names.count(name) == 1 else "".join(word.capitalize() for word in plugin.split("_"))
        for plugin, name in classes.items()
    }


for newest, (robot, task) in environment_ids().items():
    for name in dict.fromkeys((newest[:-1] + "1", newest)):
        steps = {"max_steps": STEPS[task]} if name.endswith("2") else {}
        kwargs = {"robot": robot, "task": task, **steps}
        gymnasium.register(name, ENTRY_POINT, vector_entry_point=VECTOR, kwargs=kwargs)
