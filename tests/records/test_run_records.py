from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

from hypothesis import given
from hypothesis import strategies as st

from karolos.records.run_records import timestamp


@given(st.datetimes(datetime(2000, 1, 1), datetime(2100, 1, 1)), st.timedeltas(), st.integers(-12, 12))
def test_timestamps_sort_like_times(first: datetime, later: timedelta, hours: int) -> None:
    ours = first.replace(tzinfo=timezone(timedelta(hours=hours)))
    theirs = ours.astimezone(UTC) + abs(later) % timedelta(days=9000)
    assert (timestamp(ours) < timestamp(theirs)) == (ours < theirs)
    assert (timestamp(ours) == timestamp(theirs)) == (ours == theirs)
