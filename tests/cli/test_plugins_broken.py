"""The broken twins of third-party packages: nobody hears of them until a spec names one, and then by name."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.plugin_packages import install, python

from karolos.plugins.starter import write_starter

SPEC = "environment: {environment}\nagent: sac\nbuffer: uniform\ntraining: {{steps: 100}}\n"


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three packages beside karolos: one that does not import, one without `step`, and one that claims `toy`."""
    folder = tmp_path_factory.mktemp("broken")
    found = []
    for name, old, new in (
        ("no_import", "import numpy as np", "import numpy as np\nimport no_such_module_anywhere"),
        ("no_step", "def step(", "def stepp("),
        ("toy", "", ""),
    ):
        write_starter("environment", name, folder / name)
        module = folder / name / "src" / f"karolos_{name}" / f"{name}.py"
        module.write_text(module.read_text().replace(old, new) if old else module.read_text())
        found.append(install(folder / name))
    return found


def test_they_hurt_nobody_until_they_are_used(sources, tmp_path):
    (tmp_path / "fine.yaml").write_text(SPEC.format(environment="bit_flip").replace("sac", "dqn"))
    ran = python("-m", "karolos_cli", "check", "fine.yaml", sources=sources, folder=tmp_path)
    assert ran.returncode == 0, ran.stderr
    listed = python("-m", "karolos_cli", "plugins", "list", "environment", sources=sources, folder=tmp_path)
    assert listed.returncode == 0
    assert all(name in listed.stdout for name in ("no_import", "no_step", "karolos-toy"))


@pytest.mark.parametrize(
    ("environment", "package", "what"),
    [
        ("no_import", "karolos-no-import 0.1.0", "does not import: ModuleNotFoundError: No module named 'no_such_mod"),
        ("no_step", "karolos-no-step 0.1.0", "NoStep is no environment: it lacks step"),
        ("toy", "karolos and karolos-toy", "environment 'toy' is claimed by"),
    ],
)
def test_a_spec_that_names_one_is_told_which_plugin_of_which_package_and_where(
    sources, tmp_path, environment, package, what
):
    (tmp_path / "broken.yaml").write_text(SPEC.format(environment=environment))
    ran = python("-m", "karolos_cli", "run", "broken.yaml", sources=sources, folder=tmp_path)
    assert ran.returncode in (2, 3)
    line = ran.stderr.splitlines()[-1]  # above it: where in the plugin's own module the import failed
    assert line.startswith("broken.yaml:1:14: ")
    assert package in line
    assert what in line
    assert ("Traceback" in ran.stderr) == (environment == "no_import")
    assert not (tmp_path / "runs").exists()
