"""Tables of the results database. Times are ISO 8601 text in UTC, which sorts like the time on every database."""

from __future__ import annotations

from sqlalchemy import JSON, BigInteger, Float, ForeignKey, Integer, String, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

SCHEMA = 1
"""Version of these tables, kept in `karolos_schema`."""


class Table(DeclarativeBase):
    """Base of the tables."""


class SchemaVersion(Table):
    """One row: the version of the tables. Its presence tells a karolos database from any other."""

    __tablename__ = "karolos_schema"

    version: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)


class ExperimentRow(Table):
    """One spec without its seeds: what the runs with the same hash have in common."""

    __tablename__ = "experiments"

    hash: Mapped[str] = mapped_column(String(128), primary_key=True)
    name: Mapped[str] = mapped_column(String(64), index=True)
    spec: Mapped[dict[str, object]] = mapped_column(JSON)


class RunRow(Table):
    """One spec, one seed: the fields of RunSummary. `folder` is relative to the database's own folder below it."""

    __tablename__ = "runs"

    run: Mapped[str] = mapped_column(String(200), primary_key=True)
    experiment: Mapped[str] = mapped_column(ForeignKey("experiments.hash"), index=True)
    seed: Mapped[str] = mapped_column(String(64))  # text: a seed may have more than 64 bits
    state: Mapped[str] = mapped_column(String(16), index=True)
    steps: Mapped[int] = mapped_column(BigInteger)
    seconds: Mapped[float] = mapped_column(Float(53))
    success_any: Mapped[float | None] = mapped_column(Float(53))
    success_end: Mapped[float | None] = mapped_column(Float(53))
    steps_to_95: Mapped[int | None] = mapped_column(BigInteger)
    seconds_to_95: Mapped[float | None] = mapped_column(Float(53))
    name: Mapped[str] = mapped_column(String(64), index=True)
    episodes: Mapped[int | None] = mapped_column(Integer)
    environment: Mapped[str | None] = mapped_column(String(128))
    robot: Mapped[str | None] = mapped_column(String(128))
    task: Mapped[str | None] = mapped_column(String(128))
    agent: Mapped[str | None] = mapped_column(String(128))
    attempt: Mapped[int] = mapped_column(Integer)
    error: Mapped[str | None] = mapped_column(Text)
    created: Mapped[str] = mapped_column(String(32), index=True)
    updated: Mapped[str] = mapped_column(String(32))
    folder: Mapped[str] = mapped_column(Text)


class TestRow(Table):
    """One test of a run: k of n, by both ways to count success. Episode by episode it stands in the run folder."""

    __tablename__ = "tests"
    __test__ = False  # not a test case, whatever its name says to pytest

    run: Mapped[str] = mapped_column(ForeignKey("runs.run", ondelete="CASCADE"), primary_key=True)
    steps: Mapped[int] = mapped_column(BigInteger, primary_key=True)
    seconds: Mapped[float] = mapped_column(Float(53))
    episodes: Mapped[int] = mapped_column(Integer)
    successes_any: Mapped[int] = mapped_column(Integer)
    successes_end: Mapped[int] = mapped_column(Integer)
    solved_at_reset: Mapped[int] = mapped_column(Integer)
