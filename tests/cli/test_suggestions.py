"""A mistyped value is answered with the closest one that exists."""

from pathlib import Path

import pytest
from karolos_cli.main import app
from support.commands import refused
from support.run_samples import add_run
from support.sweep_samples import some_trial, write_sweep
from typer.testing import CliRunner


@pytest.fixture
def runs(runs: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("COLUMNS", "200")
    add_run(runs, 0)
    write_sweep(runs, "grid", [some_trial(0)])
    return runs


@pytest.mark.usefixtures("runs")
@pytest.mark.parametrize(
    ("command", "suggestion"),
    [
        ("runs list --state finisched", "did you mean 'finished'?"),
        ("runs list state=finisched", "did you mean 'finished'?"),
        ("runs list agent.learning_rat=1", "did you mean agent.learning_rate?"),
        ("runs list --columns run,sucess_end", "did you mean 'success_end'?"),
        ("runs show reech", "did you mean 'reach'?"),
        ("play panda_pik", "did you mean 'panda_pick', a shipped policy?"),
        ("play nothing_like_it", "policies ship, e.g. panda_pick"),
        ("sweeps show gird", "did you mean 'grid'?"),
        ("inspect robot pnada", "did you mean 'panda'?"),
        ("plugins show robto panda", "did you mean 'robots'?"),
        ("plugins show robot pnada", "did you mean 'panda'?"),
        ("plugins list robto", "did you mean 'robots'?"),
    ],
)
def test_closest_value_is_suggested(command, suggestion):
    assert suggestion in refused(*command.split())


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("run panda_reach_p", "panda_reach_pose panda_reach_ppo"),
        ("run my", "my.yaml my/other.yml"),
        ("play rea", "reach RUN"),
        ("play panda_thr", "panda_throw"),
        ("play --expert panda_reach_p", "panda_reach_pose panda_reach_ppo"),
        ("run x agent=s", "agent=sac"),
        ("run x agent = s", "sac"),
        ("run x agent =", "ddpg dqn ppo sac td3"),
        ("plugins show agents t", "td3"),
        ("inspect task reach_", "reach_pose"),
        ("sweeps show g", "grid"),
        ("runs tag x go", "good"),
    ],
)
def test_tab_completes(runs, monkeypatch, words, found):
    monkeypatch.chdir(runs)
    for path in (Path("my.yaml"), Path("my/other.yml")):
        path.parent.mkdir(exist_ok=True)
        path.touch()
    (run,) = (path.parent.name for path in runs.glob("*/run.json"))
    (runs / run / "labels.json").write_text('{"tags": ["good"]}')
    place = {"COMP_WORDS": f"karolos {words}", "COMP_CWORD": str(len(words.split()))}
    shown = CliRunner().invoke(app, [], env={"_KAROLOS_COMPLETE": "complete_bash", **place}, prog_name="karolos")
    assert shown.stdout.split() == found.replace("RUN", run).split()
