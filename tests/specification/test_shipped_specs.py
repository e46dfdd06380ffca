"""The specs and the plugins that ship, their schema, and a number where a distribution is expected."""

from functools import cache
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from support.spec_files import GOOD, REFUSED, problems_of, write

from karolos.errors import SpecError, UsageError
from karolos.experiment.check import check_parts
from karolos.specification import load_spec, spec_from_dict
from karolos.specification.files import read, shipped_text
from karolos.specification.schema import spec_schema

SPECS = Path(__file__).parents[2] / "specs"
SUITES = [SPECS / "all_tasks.yaml", SPECS / "smoke" / "toy_suite.yaml"]
RUNNABLE = sorted({*SPECS.glob("*.yaml"), *SPECS.glob("smoke/*.yaml")}.difference(SUITES))
ALL = sorted({*SPECS.rglob("*.yaml")}.difference(SUITES))


@cache
def shipped_validator() -> Draft202012Validator:
    schema, broken = spec_schema()
    assert not broken
    return Draft202012Validator(schema)


@pytest.mark.parametrize("path", ALL, ids=lambda path: str(path.relative_to(SPECS)))
def test_shipped_spec_fits_the_schema_and_loads_again_as_its_copy_does(tmp_path, path):
    node, problems = read(path.read_text("utf-8"), path.name)
    assert not problems
    assert node is not None
    wrong = sorted(error.json_path for error in shipped_validator().iter_errors(node.plain()))
    needs_base = path.parent.name == "bases"  # a base may leave robot and task to the spec that extends it
    assert [place for place in wrong if not (needs_base and place == "$")] == []
    copied = write(tmp_path, path.name, shipped_text(str(path.relative_to(SPECS).with_suffix(""))))
    if path in RUNNABLE:
        spec = load_spec(path)
        assert load_spec(copied) == spec_from_dict(spec.dump()) == spec
        assert set(spec.origins.values()) != {"default"}


GENERAL = {"ppo": "reach push pick_place throw", "sac_grasp": "push pick_place stack"}
"""The tasks of bases that set none."""
GENERAL["sac_hindsight"] = GENERAL["ppo"]
BESIDE = {"arms": "karolos:bases/pick.yaml, "}
"""A transfer stands beside the base of a task."""


@pytest.mark.parametrize("base", sorted(path.stem for path in SPECS.glob("bases/*.yaml")))
def test_base_needs_nothing_but_a_robot_and_a_task(tmp_path, base):
    for task in GENERAL.get(base, "").split() or [None]:
        (tmp_path / "mine.yaml").write_text(
            f"extends: [{BESIDE.get(base, '')}karolos:bases/{base}.yaml]\nrobot: panda\n"
            f"{f'task: {task}' if task else ''}\n"
        )
        check_parts(load_spec(tmp_path / "mine.yaml"))


def test_shipped_spec_is_found_by_name_and_a_file_comes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shipped = load_spec("panda_reach")
    assert shipped == load_spec(SPECS / "panda_reach.yaml") == load_spec("karolos:panda_reach.yaml")
    assert shipped.text == (SPECS / "panda_reach.yaml").read_text("utf-8")
    assert shipped.origins["robot.name"].startswith("karolos:panda_reach.yaml:3:")
    Path("panda_reach").write_text("extends: karolos:panda_push.yaml\nseeds: [7]\n")
    assert (load_spec("panda_reach").seeds, load_spec("panda_reach").task.name) == ((7,), "push")
    assert load_spec("karolos:panda_reach") == shipped


def test_override_of_a_name_keeps_the_settings_that_both_plugins_have_and_origins_tell():
    path = SPECS / "panda_reach.yaml"
    before, after = load_spec(path), load_spec(path, ["buffer.name=priority"])
    assert after.buffer.name == "priority"
    assert after.buffer.settings.hindsight == before.buffer.settings.hindsight
    assert after.buffer.settings.hindsight is not None
    assert "bases/sac_hindsight.yaml" in after.origins["buffer.hindsight.ratio"]
    agent = load_spec(path, ["agent.noise.kind=gaussian", "agent.tau=0.1", "agent.name=td3"]).agent
    assert agent.settings.learning_rate == before.agent.settings.learning_rate
    assert agent.settings.tau == 0.1
    assert agent.settings.noise.std == 0.2  # td3's own: its noise has another type
    robot = load_spec(SPECS / "ur5_push.yaml", ["robot={name: panda, reset_noise: 0.01}"]).robot
    assert (robot.settings.base, robot.settings.reset_noise) == ("centred", 0.01), "with other settings, too"


REACH = "robot: panda\ntask: reach\nagent: sac\n"


def test_a_number_is_a_distribution_of_one_value(tmp_path):
    plain = load_spec(write(tmp_path, "s.yaml", REACH + "randomization: {task.gravity: -5}\n"))
    drawn = {"name": "choice", "values": [-5.0], "weights": None}
    assert plain.dump()["randomization"] == {"task.gravity": drawn}
    written = "randomization: {task.gravity: {name: choice, values: [-5]}}\n"
    assert plain.hash() == load_spec(write(tmp_path, "t.yaml", REACH + written)).hash()
    override = "randomization.task.gravity=-5"
    assert plain.hash() == load_spec(write(tmp_path, "u.yaml", REACH), [override]).hash()
    (line,) = problems_of(write(tmp_path, "v.yaml", REACH), override.replace("-5", ".inf"))
    assert "randomization.task.gravity.values[0]: should be a finite number" in line


def test_a_value_that_the_parameter_never_takes_is_refused_before_a_run(tmp_path):
    path = write(tmp_path, "s.yaml", REACH + "randomization: {task.gravity: -50}\n")
    with pytest.raises(UsageError, match=r"s\.yaml:4:\d+: randomization\.task\.gravity: .* allowed is -20 to 0 m/s2"):
        check_parts(load_spec(path))


@pytest.mark.parametrize(
    ("override", "example"), [("task.gravity=-5", "task.gravity"), ("robot.link_mas=2", "robot.link_mass")]
)
def test_a_parameter_among_the_settings_is_told_where_it_goes_and_a_misspelt_one_is_not_repeated(
    tmp_path, override, example
):
    (line,) = problems_of(write(tmp_path, "s.yaml", REACH), override)
    part, name = ("task", "reach") if "task" in override else ("robot", "panda")
    hint = f"is set as e.g. randomization: {{{example}: NUMBER}}; `karolos inspect {part} {name}` shows all"
    assert "no such key" in line
    assert line.endswith(hint)


def test_an_agent_that_needs_another_buffer_is_told_at_its_override_with_a_spec_that_has_both():
    with pytest.raises(SpecError) as caught:
        load_spec("panda_reach", ["training.steps=5", "agent=ppo"])
    line = str(caught.value)
    assert line.startswith("override agent=ppo: buffer: agent 'ppo' learns from its own latest actions only")
    assert line.endswith("e.g. buffer=on_policy; the spec panda_reach_ppo shows the settings of both")
    assert load_spec("panda_reach_ppo").buffer.name == "on_policy"


def test_a_number_of_seeds_means_the_first_ones(tmp_path):
    path = write(tmp_path, "s.yaml", REACH + "seeds: 3\n")
    assert load_spec(path).seeds == (0, 1, 2)
    assert load_spec(path, ["seeds=1"]) == load_spec(path, ["seeds=[0]"])


def test_a_home_folder_in_a_path_is_refused(tmp_path):
    (line,) = problems_of(write(tmp_path, "s.yaml", REACH.replace("sac", "{name: sac, start_from: ~/x}")))
    assert line.startswith("s.yaml:3:32: agent.start_from: ~/x: ~ and variables are not replaced")


FITTING = [
    "robot: arm\ntask: reach\nagent: learner",
    "environment: point\nagent: {name: learner, discount: 0.5, decay: {rate: 0.1}}\nseeds: [0, 1]",
    "extends: base.yaml\ntraining: {steps: 1e6}\nrobot: null",
    "extends: [a.yaml, b.yaml]\nagent: {discount: 0.5}",
    "robot: arm\ntask: reach\nagent: learner\nbuffer: {name: uniform, hindsight: {ratio: 0.5}}\n"
    "randomization: {task.gravity: {name: normal, mean: 1, std: 1}, robot.gain: 2}",
]
UNFIT = ["misspelt choice", "misspelt key of a nested setting", "robot without a task", "no agent", "misspelt name"]
UNFIT += ["misspelt setting", "name that is a path", "out of range", "randomization that names no owner"]
UNFIT += ["misspelt top key"]
"""Of what tests/support/refused.yaml holds."""


def test_good_specs_fit_the_schema_and_bad_ones_do_not(fake_plugins):
    schema, broken = spec_schema()
    Draft202012Validator.check_schema(schema)
    assert not broken
    bad = [REFUSED["specs"][case] for case in UNFIT]
    for text, good in (
        *((text, True) for text in FITTING),
        *((one["spec"] if "spec" in one else GOOD + one["after"], False) for one in bad),
    ):
        node, _ = read(text, "s")
        assert node is not None
        assert Draft202012Validator(schema).is_valid(node.plain()) == good, text


def test_plugin_that_does_not_import_is_left_out_and_told(fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot")
    schema, broken = spec_schema()
    Draft202012Validator.check_schema(schema)
    assert "robots.arm" in schema["$defs"]
    assert "robots.broken" not in schema["$defs"]
    assert len(broken) == 1
    assert "'broken'" in str(broken[0])


def test_a_setting_that_came_later_is_in_the_hash_if_it_is_not_at_its_default():
    hashes = [
        load_spec("panda_reach", [f"buffer.augmentation.{given}"]).hash() for given in ("shift=0.1", "lift=0", "lift=1")
    ]
    assert hashes[0] == hashes[1] != hashes[2]
    # of 0.2, where `hindsight.others_share` was not known
    hash_of_0_2 = "ac683891b0418c5c26c14f7937b16be5bd1ef02daafb443a4a80f868937f3b0f"
    assert load_spec("panda_reorient_demos").hash() == hash_of_0_2
