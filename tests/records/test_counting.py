from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.run_samples import result

from karolos.records.counting import TestCounts, count_lines
from karolos.records.results import TestResult
from karolos.records.run_records import decode_test, encode_test

results = st.integers(1, 9).flatmap(
    lambda n: st.builds(
        TestResult,
        steps=st.integers(0, 2**60),
        seconds=st.floats(0, 1e9),
        any=st.tuples(*[st.booleans()] * n),
        end=st.tuples(*[st.booleans()] * n),
        reset=st.tuples(*[st.booleans()] * n),
        returns=st.tuples(*[st.floats()] * n),
        lengths=st.tuples(*[st.integers(0, 2**40)] * n),
        distances=st.none() | st.tuples(*[st.floats(0)] * n),
    )
)


def line(row: dict[str, Any]) -> bytes:
    return json.dumps(row, separators=(",", ":"), allow_nan=False).encode() + b"\n"


@given(st.lists(results, max_size=4))
def test_counts_of_the_text_are_those_of_the_tests(tests: list[TestResult]) -> None:
    assert count_lines(b"".join(line(encode_test(test)) for test in tests)) == [TestCounts.of(test) for test in tests]


@given(results)
def test_counts_have_the_shares_of_the_test(test: TestResult) -> None:
    counts = TestCounts.of(test)
    assert (counts.success_any, counts.success_end) == (test.success_any, test.success_end)
    assert (counts.steps, counts.seconds, counts.episodes) == (test.steps, test.seconds, test.episodes)


@given(st.data())
def test_damaged_line_is_counted_right_or_left_to_the_long_way(data: st.DataObject) -> None:
    text = bytearray(line(encode_test(result(10, 1, episodes=2))))
    place = data.draw(st.integers(0, text.index(b"returns")))
    text[place : place + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=2))
    counted = count_lines(bytes(text))
    if counted is not None:
        decoded = [decode_test(json.loads(part)) for part in bytes(text).split(b"\n")[:-1]]
        assert counted == [TestCounts.of(test) for test in decoded if test is not None]


def test_line_that_is_cut_anywhere_is_left_to_the_long_way() -> None:
    whole = line(encode_test(result(10, 1, episodes=2)))
    assert all(count_lines(whole + whole[:end]) is None for end in range(1, len(whole)))
    assert all(count_lines(whole[:end] + b"\n") is None for end in range(len(whole) - 1))


@pytest.mark.parametrize("change", [{"any": []}, {"end": [1]}, {"steps": "x"}, {"lengths": [None, 1]}, {"more": 1}])
def test_other_lines_are_left_to_the_long_way(change: dict[str, Any]) -> None:
    row = encode_test(result(10, 1, episodes=2))
    assert count_lines(line(row)) is not None
    assert count_lines(line(row) + line(row | change)) is None
    assert count_lines(line(row) + line(row)[:-1]) is None
    assert count_lines(b"") == []
