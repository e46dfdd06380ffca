from __future__ import annotations

import json
import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.run_samples import result

from karolos.records.decode import from_json
from karolos.records.results import (
    FinalTest,
    TestCounts,
    TestResult,
    decode_final,
    decode_test,
    encode_final,
    encode_test,
)

results = st.integers(1, 9).flatmap(
    lambda n: st.builds(
        TestResult,
        steps=st.integers(0, 2**60),
        seconds=st.floats(0, 1e9),
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


def line(row: dict[str, Any]) -> bytes:
    return json.dumps(row, separators=(",", ":"), allow_nan=False).encode()


@given(results)
def test_counts_of_a_line_are_those_of_the_test(test: TestResult) -> None:
    assert from_json(TestCounts, line(encode_test(test))) == TestCounts.of(test)


@given(results)
def test_line_gives_the_test_back(test: TestResult) -> None:
    assert repr(decode_test(line(encode_test(test)))) == repr(test)
    assert repr(decode_test(encode_test(test))) == repr(test)


@given(results)
def test_counts_have_the_fractions_of_the_test(test: TestResult) -> None:
    counts = TestCounts.of(test)
    expected = (test.success_any, test.success_end) if test.has_success else (None, None)
    assert (counts.success_any, counts.success_end) == expected
    assert counts.mean_return is None or counts.mean_return == pytest.approx(
        float(sum(map(Fraction, test.returns)) / test.episodes)
    )
    assert (counts.steps, counts.seconds, counts.episodes) == (test.steps, test.seconds, test.episodes)


@pytest.mark.parametrize("returns", [(math.nan, 1.0), (math.inf, 1.0), (math.inf, -math.inf), (1e308, 1e308)])
def test_mean_return_that_is_not_finite_is_unknown(returns: tuple[float, float]) -> None:
    test = replace(result(10, 1, episodes=2), returns=returns)
    assert TestCounts.of(test).mean_return is None
    assert math.isnan(test.mean_return)


def test_score_of_an_environment_without_success_is_its_return() -> None:
    test = result(10, 1, episodes=2)
    assert test.score == "success end 0.50, any 0.50, return -1.50"
    assert replace(test, has_success=False).score == "return -1.50"


def test_line_that_is_cut_anywhere_is_no_test() -> None:
    whole = line(encode_test(result(10, 1, episodes=2)))
    for end in range(len(whole)):
        assert from_json(TestCounts, whole[:end]) is decode_test(whole[:end]) is None


@pytest.mark.parametrize(
    "change",
    [
        *({"any": []}, {"end": [1]}, {"steps": "x"}, {"steps": -1}, {"steps": 1 << 63}, {"seconds": "nan"}),
        *({"returns": None}, {"lengths": [None]}, {"distances": [0.1]}),
    ],
)
def test_line_that_holds_no_whole_test_is_none(change: dict[str, Any]) -> None:
    row = encode_test(result(10, 1, episodes=2))
    assert decode_test(row) == result(10, 1, episodes=2)
    assert decode_test(row | change) is None


@pytest.mark.parametrize(("best", "lines"), [("a", 2), ("b", 3), (None, 2)])
def test_a_final_test_is_written_once_where_the_last_policy_is_the_best(best: str | None, lines: int) -> None:
    played = TestResult(steps=10, seconds=1.0, any=(True,), end=(True,), reset=(False,), returns=(0.0,), lengths=(3,))
    final = FinalTest(7, played, None if best is None else played, "a", best)
    rows = [json.dumps(row) for row in encode_final(final)]
    assert len(rows) == lines
    written = "".join(f"{row}\n" for row in rows)
    assert decode_final(written.encode()) == final
    older = written + f"{rows[1]}\n"  # of 0.1: one more where the best is the last, damaged elsewhere
    assert decode_final(older.encode()) == (final if best == "a" else None)
