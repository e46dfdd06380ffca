from __future__ import annotations

import json
from pathlib import Path

import pytest
from karolos_cli.bench import app
from typer.testing import CliRunner

from karolos.benchmarks import agent_peers, agents
from karolos.benchmarks.agents import ENTRIES, chosen, entry_spec
from karolos.errors import SpecError, UsageError
from karolos.records import scan
from karolos.training.assembly import check_parts


@pytest.mark.parametrize("case", ENTRIES)
def test_every_entry_is_a_spec_whose_parts_go_together(case: str) -> None:
    spec = entry_spec(ENTRIES[case])
    assert spec.agent.name == case.split()[1]
    assert spec.buffer.name == (
        "priority" if case.endswith("priority") else "on_policy" if "ppo" in case else "uniform"
    )
    check_parts(spec)


def test_entries_differ_in_what_they_run() -> None:
    hashes = [entry_spec(entry).hash() for entry in ENTRIES.values()]
    assert len(set(hashes)) == len(hashes)


def test_recipes_of_the_peer_belong_to_entries() -> None:
    assert set(agent_peers.RECIPES) <= {entry.spec for entry in ENTRIES.values()}


def test_a_finished_seed_is_not_run_again_and_the_table_is_written(tmp_path: Path) -> None:
    arguments = ["agents", "--runs", str(tmp_path), "--quick", "--only", "bit_flip dqn without", "--json"]
    for seeds in ("1", "2", "2"):
        result = CliRunner().invoke(app, [*arguments, "--seeds", seeds])
        assert result.exit_code == 0, result.output
        assert len(list(scan(tmp_path))) == int(seeds)
    row = json.loads(result.stdout)
    assert row["case"] == "bit_flip dqn without hindsight"
    assert row["unit"] == "success"
    table = (tmp_path / "agents.md").read_text().splitlines()
    assert len(table) == 3
    assert "| <= 0.05 |" in table[2]
    (stored,) = json.loads((tmp_path / "agents.json").read_text())["rows"]
    assert len(stored["values"]) == 2
    assert row["value"] == pytest.approx(sum(stored["values"]) / 2)


def test_overrides_hold_for_every_entry_that_is_chosen() -> None:
    for case in chosen(["pendulum sac"]):
        assert entry_spec(ENTRIES[case], ["agent.precision=float32"]).agent.settings.precision == "float32"
    with pytest.raises(SpecError, match="precision"):
        entry_spec(ENTRIES["pendulum ppo"], ["agent.precision=float32"])


def test_a_peer_is_not_compared_with_entries_that_are_overridden(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["agents", "agent.precision=float32", "--peers", "--runs", str(tmp_path)])
    assert isinstance(result.exception, UsageError)
    assert not list(tmp_path.iterdir())


def test_entries_are_chosen_by_how_their_names_begin() -> None:
    assert chosen(["pendulum sac"]) == ["pendulum sac", "pendulum sac priority"]
    with pytest.raises(UsageError, match="no entry"):
        chosen(["pendulm"])


def test_a_peer_also_makes_the_steps_that_its_settings_are_tuned_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(agent_peers, "require", lambda: None)
    monkeypatch.setattr(agent_peers, "value", lambda name, spec, steps, seed, unit, folder: float(steps + seed))
    monkeypatch.setattr(agents, "_values", lambda spec, unit, folder, jobs, listener: [500.0] * len(spec.seeds))
    said: list[str] = []
    only = ["cartpole dqn", "cartpole ppo"]
    results = list(agents.measure(tmp_path, only=only, seeds=2, peers=True, say=said.append))
    rows = [row.dump() for row in results[0].rows()]
    assert [(row["steps"], row["episodes"], row["peer_steps"], row["peer_value"]) for row in rows] == [
        (30_000, 100, 30_000, 30_000.5),
        (30_000, 100, 50_000, 50_000.5),
    ]
    assert {row["peer_settings"] for row in rows} == {"zoo, dqn.yml, CartPole-v1"}
    assert len(results[-1].rows()) == 1, "tuned for the same number"
    assert "cartpole dqn, seed 1, stable-baselines3 after 50,000 steps: 5e+04" in said
    table = (tmp_path / "agents.md").read_text()
    assert "| 5e+04 after 50,000: 5e+04 5e+04 | zoo, dqn.yml, CartPole-v1 |" in table


def test_every_recipe_of_the_peer_says_where_it_is_from() -> None:
    assert all(recipe["source"] for recipe in agent_peers.RECIPES.values())
