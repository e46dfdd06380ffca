"""The card of an exported policy, as the hub reads it."""

import yaml
from karolos_cli.main import app
from support.commands import call


def test_the_card_of_a_policy_has_the_front_matter_of_the_hub(tmp_path):
    code, _, _ = call(app, "export", "shipped:panda_pick", "--out", str(tmp_path), "--no-onnx", "--card")
    assert code == 0
    _, front, text = (tmp_path / "README.md").read_text().split("---\n", 2)
    found = yaml.safe_load(front)
    [model] = found["model-index"]
    [result] = model["results"]
    assert (found["library_name"], model["name"], result["dataset"]["name"]) == ("karolos", "SAC", "panda pick_place")
    metrics = {one["type"]: one["value"] for one in result["metrics"]}
    assert metrics["success_end"] > 0.9
    assert "in 1000 episodes (held out)" in text
