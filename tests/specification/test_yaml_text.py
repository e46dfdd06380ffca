"""YAML text: 1.2 scalars, positions, and what is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from karolos.errors import SpecError
from karolos.specification.files import read, scalar, to_yaml

SCALARS: dict[object, str] = {
    0.001: "1e-3",
    1e6: "1e6",
    -9.81: "-9.81",
    0.5: ".5",
    5.0: "5.",
    7: "+7",
    10: "010",
    31: "0x1F",
    15: "0o17",
    math.inf: ".inf",
    -math.inf: "-.INF",
    None: "null ~",
}
WORDS = "no on yes off 1_000 1:30 2024-01-01 0b11 e3 . 1.2.3 ٣"
"""What is a number or a truth in YAML 1.1, or nearly one in 1.2."""


def test_plain_scalars_follow_the_core_schema():
    written = [(text, value) for value, texts in SCALARS.items() for text in texts.split()]
    for text, value in (
        *written,
        ("true", True),
        ("False", False),
        ("", None),
        *((word, word) for word in WORDS.split()),
    ):
        found = scalar(text)
        assert found == value
        assert type(found) is type(value)
    assert math.isnan(scalar(".nan"))


def test_quoted_scalars_are_strings():
    node, problems = read("a: '5'\nb: \"true\"\nc: |\n  7\n", "x")
    assert not problems
    assert node.plain() == {"a": "5", "b": "true", "c": "7\n"}


@pytest.mark.parametrize(
    "text", ["a:\t1", "a\t: 1", "\t\na: 1\t\n \t# x\n\t", "a:\n  1\n\t# x", "{a:\t1\n\t}", "{\n\ta: 1}"]
)
def test_tabs_may_separate(text):
    node, problems = read(text, "x")
    assert not problems
    assert node.plain() == {"a": 1}


@pytest.mark.parametrize("text", ["a:\n\tb: 1", "a:\n \tb: 1", "\ta: 1", "- \ta: 1", "a: |\n  b\n\tc"])
def test_tabs_may_not_indent(text):
    with pytest.raises(SpecError, match="indent with spaces"):
        read(text, "x")


def test_every_key_and_value_knows_its_place():
    node, _ = read("a: 1\nb:\n  c: {d: 2}\n  e:\n  - 3\n", "f.yaml")
    assert str(node.get("a").at) == "f.yaml:1:4"
    assert str(node.get("b", "c", "d").key) == "f.yaml:3:7"
    assert str(node.get("b", "c", "d").at) == "f.yaml:3:10"
    assert str(node.get("b", "e", 0).at) == "f.yaml:5:5"


def test_aliases_repeat_the_value():
    node, problems = read("a: &x [1, 2]\nb: *x\n", "f")
    assert not problems
    assert node.plain() == {"a": [1, 2], "b": [1, 2]}


@pytest.mark.parametrize(
    ("text", "place", "what"),
    [
        ("a: 1\nb: 2\na: 3\n", "f:3:1", "duplicate key 'a', first at f:1:1"),
        ("a: !!python/object:os.system x\n", "f:1:4", "tag"),
        ("a: !!str 5\n", "f:1:4", "tag"),
        ("a: !custom [1]\n", "f:1:4", "tag"),
        ("1: x\n", "f:1:1", "key 1 is not a string"),
        ("true: x\n", "f:1:1", "key True is not a string"),
        ("? [a]\n: x\n", "f:1:3", "not a string"),
        (f"a: {'9' * 5000}\n", "f:1:4", "digits"),
    ],
)
def test_what_has_no_place_in_a_spec_is_told_and_the_rest_read(text, place, what):
    node, problems = read(text + "z: 7\n", "f")
    assert [str(problem.where) for problem in problems] == [place]
    assert what in problems[0].what
    assert node.get("z").value == 7


@pytest.mark.parametrize(
    ("text", "place", "what"),
    [
        ("a: [1, 2\n", "f:2:1", "not valid YAML"),
        ("a:\n\tb: 1\n", "f:2:1", "not valid YAML"),
        ("a: 'x\n", "f:2:1", "not valid YAML"),
        ("a: 1\n---\nb: 2\n", "f:2:1", "found another document"),
        ("a: *nothing\n", "f:1:4", "found undefined alias 'nothing'"),
        ("a: &x [*x]\n", "f:1:4", "nested deeper"),
        ("a: " + "[" * 60 + "]" * 60, None, "nested deeper"),
        ("[" * 5000, None, "nested deeper"),
        ("a: b\x00c\n", "f:1:5", "not valid YAML"),
        ("x" * 300_000, "f", "longer than"),
    ],
)
def test_unreadable_text_tells_where(text, place, what):
    with pytest.raises(SpecError) as caught:
        read(text, "f")
    assert what in caught.value.problems[0].what
    assert "\n" not in caught.value.problems[0].what
    if "\t" in text:
        assert caught.value.problems[0].hint == "indent with spaces"
    if place:
        assert str(caught.value.problems[0].where) == place


def test_alias_bomb_is_refused():
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10)]
    with pytest.raises(SpecError, match="aliases expanded"):
        read("\n".join(lines), "bomb")


def test_text_without_a_document_is_empty():
    assert read("", "f")[0] is None
    assert read("# nothing\n", "f")[0] is None


words = st.sampled_from(["no", "on", "1e-3", "1e6", "0o17", "010", "null", "~", "", "true", "=", "1:30", ".inf", " x "])
printable = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), max_size=8)
scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | words | printable
values = st.recursive(
    scalars,
    lambda below: st.lists(below, max_size=3) | st.dictionaries(words | printable, below, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(printable | words, values, min_size=1, max_size=4))
def test_written_yaml_reads_as_the_same_data(data):
    node, problems = read(to_yaml(data), "f")
    assert not problems
    assert node.plain() == data


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused_by_name(text):
    try:
        node, problems = read(text, "f")
    except SpecError:
        return  # anything else is a fault
    assert node is None or node.at.line >= 1
    assert all(problem.what for problem in problems)
