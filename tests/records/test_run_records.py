from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from karolos.records.run_records import RunState, timestamp


@pytest.mark.parametrize("row", [{"state": "done"}, {"steps": "many"}, {"steps": float("inf")}, {"seconds": []}])
def test_an_object_that_is_not_a_state_is_none(row: dict[str, Any]) -> None:
    assert RunState.from_row({}) == RunState("created")
    assert RunState.from_row(row) is None


@given(st.datetimes(datetime(2000, 1, 1), datetime(2100, 1, 1)), st.timedeltas(), st.integers(-12, 12))
def test_timestamps_sort_like_times(first: datetime, later: timedelta, hours: int) -> None:
    ours = first.replace(tzinfo=timezone(timedelta(hours=hours)))
    theirs = ours.astimezone(UTC) + abs(later) % timedelta(days=9000)
    assert (timestamp(ours) < timestamp(theirs)) == (ours < theirs)
    assert (timestamp(ours) == timestamp(theirs)) == (ours == theirs)
