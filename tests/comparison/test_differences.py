from hypothesis import given
from hypothesis import strategies as st

from karolos.comparison.differences import MISSING, Side, compare_sides, differences

LEAF = st.sampled_from([None, True, 0, 1, "", "a", (), (0, 1)])
KEY = st.sampled_from(["a", "b", "c"])
BLOCK = st.dictionaries(KEY, LEAF | st.dictionaries(KEY, LEAF, max_size=3), max_size=3)
SPEC = st.dictionaries(KEY, LEAF | BLOCK, max_size=3)


@given(SPEC)
def test_spec_does_not_differ_from_itself(spec):
    assert differences([spec, spec, spec]) == {}


@given(SPEC, SPEC)
def test_difference_is_the_same_from_both_sides(one, other):
    there, back = differences([one, other]), differences([other, one])
    assert {key: pair[::-1] for key, pair in there.items()} == back
    assert bool(there) == (one != other)


def test_each_key_of_a_block_that_a_side_lacks_is_a_row():
    assert differences([{"robot": {"name": "ur5", "base": {"x": 0}}, "x": 1}, {"robot": None, "x": 1}]) == {
        "robot": (MISSING, None),
        "robot.name": ("ur5", MISSING),
        "robot.base.x": (0, MISSING),
    }
    assert differences([{}, {"noise": {"kind": "a"}}, {"noise": {}}]) == {
        "noise": (MISSING, MISSING, {}),
        "noise.kind": (MISSING, "a", MISSING),
    }


def test_settings_of_another_plugin_are_rows_beside_those_of_the_same_part():
    one = {"agent": {"name": "sac", "rate": 1, "tau": 1}, "buffer": {"a": {"b": 1}}}
    other = {"agent": {"name": "ppo", "rate": 2, "clip": 1, "epochs": 3}, "buffer": {"a": {"b": 2}}}
    assert list(differences([one, other]).items()) == [
        ("agent.name", ("sac", "ppo")),
        ("agent.rate", (1, 2)),
        ("agent.tau", (1, MISSING)),
        ("agent.clip", (MISSING, 1)),
        ("agent.epochs", (MISSING, 3)),
        ("buffer.a.b", (1, 2)),
    ]


PATCH = "diff --git a/x.py b/x.py\n--- a/x.py\n+++ b/x.py\n@@ -1 +1,2 @@\n-old\n+new\n+newer\n"
MORE = "diff --git a/y.py b/y.py\n--- a/y.py\n+++ b/y.py\n@@ -1 +1 @@\n-a\n+b\n"


def side(name: str = "one", **values: object) -> Side:
    return Side(
        **{"name": name, "spec": {}, "versions": {}, "sources": {}, "seed": 0, "commit": "abc", "patch": ""} | values
    )  # type: ignore[arg-type]


def test_each_changed_file_is_a_row_that_says_which_side_misses_its_key():
    change = {"part": "code", "key": "x.py", "a": "changed: +2 -1", "missing": None}
    other = side("two", patch=PATCH.replace("newer", "other"))
    assert list(compare_sides(side(patch=PATCH), other)) == [change | {"b": "changed: +2 -1"}]
    assert list(compare_sides(side(patch=PATCH + MORE), side(patch=MORE))) == [change | {"b": None, "missing": "b"}]
    missing = {"part": "spec", "key": "a", "a": None, "b": None, "missing": "b"}
    assert list(compare_sides(side(spec={"a": None}), side("two"))) == [missing]
