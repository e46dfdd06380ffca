import json
import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.run_samples import result

from karolos.records.evaluation import Evaluation, decode, decode_final

results = st.integers(1, 9).flatmap(
    lambda n: st.builds(
        Evaluation.of,
        st.integers(0, 2**60),
        st.floats(0, 1e9),
        any=st.tuples(*[st.booleans()] * n),
        end=st.tuples(*[st.booleans()] * n),
        reset=st.tuples(*[st.booleans()] * n),
        returns=st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * n),
        lengths=st.tuples(*[st.integers(0, 2**40)] * n),
        distances=st.none() | st.tuples(*[st.floats(0)] * n),
        has_success=st.booleans(),
        measures=st.dictionaries(
            st.sampled_from(["peak_force", "miss"]),
            st.tuples(*[st.none() | st.floats(-1e6, 1e6)] * n).map(
                lambda values: {"unit": "N", "better": "larger", "values": values}
            ),
        ),
    )
)
TEST = result(10, 1, episodes=2)


def line(row: dict[str, Any]) -> bytes:
    return json.dumps(row, separators=(",", ":"), allow_nan=False).encode() + b"\n"


@given(results)
def test_line_gives_the_evaluation_back(test):
    about = {"checkpoint": "best", "sha256": "a", "seed": 0, "overrides": ("a=1",), "randomized": True, "time": "now"}
    for one in (test, replace(test, **about, wall_seconds=0.0, versions={"karolos": "1"}, own=test.counts)):
        assert repr(decode(line(one.encode()))) == repr(one)
        assert repr(decode(one.encode())) == repr(one)


@given(results)
def test_lines_of_older_versions_are_read(test):
    row = test.encode()
    of_0_1 = {name: row[name] for name in ("steps", "seconds", "any", "end", "reset", "returns", "lengths")}
    of_0_1 |= {} if test.has_success else {"has_success": False}
    assert repr(decode(line(of_0_1))) == repr(replace(test, distances=None, measures={}))
    about = {"checkpoint": "last", "sha256": "b", "seed": 7, "overrides": ["a=1"], "wall_seconds": 1.0}
    nested = {**about, "episodes": test.episodes, "test": row, "own": test.counts.encode()}
    assert repr(decode(line(nested))) == repr(replace(test, **about | {"overrides": ("a=1",)}, own=test.counts))


@given(results)
def test_numbers_are_those_of_the_episodes(test):
    some, end = (sum(flags) / test.episodes if test.has_success else None for flags in (test.any, test.end))
    assert (test.success_any, test.success_end, test.episodes) == (some, end, len(test.any))
    assert test.mean_return is None or test.mean_return == pytest.approx(
        float(sum(map(Fraction, test.returns)) / test.episodes)
    )
    assert test.counts == replace(
        test,
        **dict.fromkeys(("any", "end", "reset", "returns", "lengths"), ()),
        distances=None,
        measures=test.counts.measures,
    )
    assert repr(Evaluation.joined([test, test], test.episodes)) == repr(test)


@pytest.mark.parametrize("returns", [(math.nan, 1.0), (math.inf, 1.0), (math.inf, -math.inf), (1e308, 1e308)])
def test_mean_return_that_is_not_finite_is_unknown(returns):
    test = result(10, 1, episodes=2, returns=returns)
    assert test.mean_return is None
    assert math.isnan(test.known_return)


def test_text_of_an_environment_without_success_is_its_return():
    assert TEST.text == "success end 0.50, any 0.50, return -1.50"
    assert result(10, 1, episodes=2, has_success=False).text == "return -1.50"


def test_line_that_is_cut_anywhere_is_no_evaluation():
    whole = line(TEST.encode())[:-1]
    assert not [end for end in range(len(whole)) if decode(whole[:end])]


@pytest.mark.parametrize(
    "change",
    [
        *({"any": []}, {"end": [1]}, {"steps": "x"}, {"steps": -1}, {"steps": 1 << 63}, {"seconds": "nan"}),
        *({"returns": None}, {"lengths": [None]}, {"distances": [0.1]}, {"episodes": 3}),
    ],
)
def test_line_that_holds_no_whole_evaluation_is_none(change):
    assert decode(TEST.encode()) == TEST
    assert decode(TEST.encode() | change) is None


@pytest.mark.parametrize(("best", "lines"), [("a", 1), ("a", 2), ("b", 2), (None, 1)])
def test_final_tests_of_older_versions_are_read(best, lines):
    """Their first line describes the policies; where the last is the best, 0.1 has two lines and 0.2 one."""
    written = [line({"seed": 7, "last": "a", "best": best}), *[line(TEST.encode())] * lines]
    last = replace(TEST, checkpoint="last", sha256="a", seed=7)
    expected = {"last": last} | ({"best": replace(last, checkpoint="best", sha256=best)} if best else {})
    assert decode_final(b"".join(written)) == expected
    new = b"".join(line(one.encode()) for one in expected.values())
    assert decode_final(new) == expected
    for damaged in (written[:1], [*written, *written[1:], *written[1:]], [*written[:-1], written[-1][:-9]], []):
        assert decode_final(b"".join(damaged)) == {}
    assert decode_final(new[:-9]) == {}
