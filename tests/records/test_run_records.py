from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.run_samples import result

from karolos.records.results import TestResult
from karolos.records.run_records import RunState, decode_test, encode_test, timestamp


@given(
    st.integers(1, 9).flatmap(
        lambda n: st.builds(
            TestResult,
            steps=st.integers(0, 2**60),
            seconds=st.floats(0, 1e9),
            any=st.tuples(*[st.booleans()] * n),
            end=st.tuples(*[st.booleans()] * n),
            reset=st.tuples(*[st.booleans()] * n),
            returns=st.tuples(*[st.floats(allow_nan=False)] * n),
            lengths=st.tuples(*[st.integers(0, 2**40)] * n),
            distances=st.none() | st.tuples(*[st.floats(0)] * n),
        )
    )
)
def test_test_result_survives_its_line_exactly(result: TestResult) -> None:
    assert decode_test(json.loads(json.dumps(encode_test(result), allow_nan=False))) == result


@pytest.mark.parametrize(
    "change", [{"any": []}, {"end": [1]}, {"steps": "x"}, {"returns": None}, {"lengths": [None]}, {"distances": [0.1]}]
)
def test_line_that_holds_no_whole_test_is_none(change: dict[str, Any]) -> None:
    row = encode_test(result(10, 1, episodes=2))
    assert decode_test(row) == result(10, 1, episodes=2)
    assert decode_test(row | change) is None


def test_state_of_any_object_is_a_state() -> None:
    assert RunState.from_row({}).state == "created"
    assert RunState.from_row({"state": "done", "steps": "many"}).state == "created"


@given(st.datetimes(datetime(2000, 1, 1), datetime(2100, 1, 1)), st.timedeltas(), st.integers(-12, 12))
def test_timestamps_sort_like_times(first: datetime, later: timedelta, hours: int) -> None:
    ours = first.replace(tzinfo=timezone(timedelta(hours=hours)))
    theirs = ours.astimezone(UTC) + abs(later) % timedelta(days=9000)
    assert (timestamp(ours) < timestamp(theirs)) == (ours < theirs)
    assert (timestamp(ours) == timestamp(theirs)) == (ours == theirs)
