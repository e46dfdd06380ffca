import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from karolos.errors import UsageError
from karolos.store.filters import DEEPEST, parse

VALUES: dict[str, Any] = {
    "task": "pick_place",
    "state": "finished",
    "seed": 3,
    "success": 0.95,
    "agent.learning_rate": 1e-4,
    "agent.layer_norm": True,
    "agent.hidden": [256, 256],
    "robot": None,
    "run": "2026",
    "tags": ("good", "to show"),
    "note": 'it "fell"',
    "created": "2026-11-21T10:00:00Z",
}


FITS = (
    "task=pick_place and agent.learning_rate<1e-3 and state=finished",
    "task = 'pick_place'",
    'task="pick_place" AND NOT state=failed',
    "task=reach or seed=3",
    "seed=3 or task=reach and state=failed",
    "not (task=reach or seed=4)",
    "not task=reach and seed != 4",
    "seed in (1, 2, 3)",
    "seed not in [1, 2] and seed in (3) and seed==3",
    "seed=3.0 and seed>=3 and seed<=3 and seed>-1 and seed < +4",
    "agent.learning_rate=0.0001 and agent.learning_rate = .1e-3",
    "agent.layer_norm=true and not agent.layer_norm=1",
    "agent.hidden='[256, 256]' and agent.hidden ~ 256",
    "robot=null and robot!=panda and nothing=null",
    "run=2026",
    "tags=good and tags='to show' and tags~SHOW and tags!=bad and tags in (x, good)",
    r"note='it \"fell\"' and note ~ 'FELL'",
    "created>2026-11-20 and created<2026-11-22",
    "created<'2026-11-21 10:30' and created<'2026-11-21 10:00:01 UTC' and created<2026-11-21T12:30+02:00",
    "created>'2026-11-21 09:30' and created>2026-11-21T11:30+02:00 and created!=null and created~'21T10:0'",
    "agent.hidden='[256,256]' and agent.hidden in ('[1]', '[ 256,256 ]') and agent.hidden!='[256'",
    "success~9",
)
DOES_NOT_FIT = (
    "task=Pick_Place",
    "task=pick",
    "seed='3'",
    "seed<3",
    "seed=true",
    "agent.layer_norm=1",
    "agent.layer_norm>0",
    "robot=panda",
    "robot<9",
    "robot~''",
    "nothing<1 or nothing>1 or nothing=1 or nothing~1",
    "task<3 and task>3",
    "tags=show",
    "tags!=good",
    "not seed=3 and task=reach or state=failed",
)


@pytest.mark.parametrize("text", FITS + DOES_NOT_FIT)
def test_filter_fits_or_not(text):
    assert parse(text).matches(VALUES) == (text in FITS)


@pytest.mark.parametrize(
    ("text", "column", "what"),
    [
        ("", 1, "the filter is empty;"),
        ("seed=1 and created>yesterday", 20, "'yesterday' is not a time; e.g. created>2026-11-29"),
        ("updated in (2026-13-45)", 13, "'2026-13-45' is not a time;"),
        ("created>0001-01-01T00:00+05:00", 9, "'0001-01-01T00:00+05:00' is not a time;"),
        ("task", 1, "'task'"),
        ("task=", 6, "something is missing after '=';"),
        ("task===reach", 7, "'='"),
        ("task=reach seed=1", 12, "'seed'"),
        ("(task=reach", 1, "'('"),
        ("task=reach)", 11, "')'"),
        ("seed in (1,", 9, "'('"),
        ("seed in ()", 9, "'('"),
        ("task='reach", 6, '"\'"'),
        ("task=a and", 11, "something is missing after 'and';"),
        ("and task=a", 1, "'and'"),
        ("task ! a", 6, "'!'"),
        ("task(1)", 1, "'task'"),
        ("a=1 and task ~ not b", 9, "'task'"),
        ("1 < seed < 4", 1, "'1'"),
        ("seed[0] = 1", 1, "'seed'"),
        ("a=1, b=2", 1, "'a'"),
        ("seed=__import__('os')", 6, "'__import__'"),
    ],
)
def test_filter_that_cannot_be_read_names_the_column(text, column, what):
    with pytest.raises(UsageError) as caught:
        parse(text)
    assert str(caught.value).startswith(f"filter, column {column}: {what} ")


def test_filter_is_bounded():
    deep = "not " * (DEEPEST - 1)
    assert not parse(f"{deep}seed=3").matches(VALUES)
    for text in (f"not {deep}seed=3", "not " * 2000 + "seed=3", "(" * 5000):
        with pytest.raises(UsageError, match="filter, column"):
            parse(text)
    with pytest.raises(UsageError, match=r"the filter has 20,006 characters; up to 10,000"):
        parse("seed=3" + " " * 20_000)
    assert parse("seed=" + "9" * 5000).matches({"seed": math.inf})


def test_keys_are_those_that_are_named():
    assert parse("a=1 and (b.c<2 or not 'd e' in (3, f))").keys == {"a", "b.c", "d e"}


comparisons = st.tuples(st.sampled_from("abc"), st.sampled_from(["=", "!=", "<", "<=", ">", ">="]), st.integers(-3, 3))
trees: st.SearchStrategy[Any] = st.recursive(
    comparisons,
    lambda inner: st.one_of(
        st.tuples(st.just("not"), inner),
        st.tuples(st.sampled_from(["and", "or"]), inner, inner),
    ),
    max_leaves=8,
)


def write(tree: Any) -> str:
    if tree[0] == "not":
        return f"not ({write(tree[1])})"
    if tree[0] in {"and", "or"}:
        return f"({write(tree[1])}) {tree[0]} ({write(tree[2])})"
    return f"{tree[0]}{tree[1]}{tree[2]}"


def holds(tree: Any, values: dict[str, int]) -> bool:
    if tree[0] == "not":
        return not holds(tree[1], values)
    if tree[0] == "and":
        return holds(tree[1], values) and holds(tree[2], values)
    if tree[0] == "or":
        return holds(tree[1], values) or holds(tree[2], values)
    left, right = values[tree[0]], tree[2]
    return {"=": left == right, "!=": left != right, "<": left < right, "<=": left <= right, ">": left > right}.get(
        tree[1], left >= right
    )


@given(trees, st.fixed_dictionaries({key: st.integers(-3, 3) for key in "abc"}))
def test_filter_means_what_logic_does(tree, values):
    assert parse(write(tree)).matches(values) == holds(tree, values)


@given(st.text(max_size=40))
def test_any_text_is_read_or_refused(text):
    try:
        fits = parse(text).matches(VALUES)
    except UsageError:
        return
    assert fits in {True, False}


@given(st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=20))
def test_text_in_quotes_is_taken_as_it_stands(text):
    quoted = text.replace("\\", "\\\\").replace('"', '\\"')
    assert parse(f'note="{quoted}"').matches({"note": text})


def test_a_number_is_not_compared_with_a_text():
    for text, column in (("task=reach and steps>1k", 22), ("steps in (1, many)", 14), ("steps != 1_k", 10)):
        with pytest.raises(UsageError, match=rf"column {column}: '.*' is not a number, as steps is"):
            parse(text).refuse_texts({"steps"})
    parse("steps>1e3 and steps=null and steps~1k and task<b").refuse_texts({"steps"})


@pytest.mark.parametrize("text", ["state=finisched", "task=reach and state in (failed, finisched)"])
def test_state_that_does_not_exist_is_refused_with_the_closest(text):
    with pytest.raises(UsageError, match=r"'finisched' is not a state.*did you mean 'finished'"):
        parse(text).refuse_unknown(lambda _: True, lambda _: None)
    parse("state=finished or state in (failed, lost) or state=null or state~fin").refuse_unknown(
        lambda _: True, lambda _: None
    )
