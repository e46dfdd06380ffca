"""Tables of the results database. Times are ISO 8601 text in UTC, which sorts like the time on every database."""

from __future__ import annotations

from sqlalchemy import JSON, BigInteger, Float, ForeignKey, Integer, String, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

SCHEMA = 2
"""Version of these tables, kept in `karolos_schema`; a higher one comes with a migration in `migrations`."""


class Table(DeclarativeBase):
    """Base of the tables."""


class SchemaVersion(Table):
    """One row: the version of the tables. Its presence tells a karolos database from any other."""

    __tablename__ = "karolos_schema"

    version: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)


class ExperimentRow(Table):
    """What runs of the same hash have in common: their results may be put together."""

    __tablename__ = "experiments"

    hash: Mapped[str] = mapped_column(String(128), primary_key=True)


class SpecRow(Table):
    """A resolved spec without its seeds, once for all runs that have the very same one.

    Specs of one experiment may differ in what results do not depend on: name, device, threads.
    """

    __tablename__ = "specs"

    digest: Mapped[str] = mapped_column(String(64), primary_key=True)
    spec: Mapped[dict[str, object]] = mapped_column(JSON)


class ParameterRow(Table):
    """One setting of a spec: its key path (agent.learning_rate) and its value as JSON."""

    __tablename__ = "parameters"

    spec: Mapped[str] = mapped_column(ForeignKey("specs.digest", ondelete="CASCADE"), primary_key=True)
    key: Mapped[str] = mapped_column(Text, primary_key=True, index=True)
    value: Mapped[str] = mapped_column(Text)


class VersionRow(Table):
    """One package of the software that a run was made with; `software` is the digest of all of them together."""

    __tablename__ = "versions"

    software: Mapped[str] = mapped_column(String(64), primary_key=True)
    package: Mapped[str] = mapped_column(String(200), primary_key=True)
    version: Mapped[str] = mapped_column(Text)


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
    note: Mapped[str | None] = mapped_column(Text)
    spec: Mapped[str] = mapped_column(ForeignKey("specs.digest"), index=True)
    software: Mapped[str | None] = mapped_column(String(64), index=True)  # None: not known


class TagRow(Table):
    """A word that somebody gave a run. It stands in the run folder, too."""

    __tablename__ = "tags"

    run: Mapped[str] = mapped_column(ForeignKey("runs.run", ondelete="CASCADE"), primary_key=True)
    tag: Mapped[str] = mapped_column(String(200), primary_key=True, index=True)


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


class SuccessRow(Table):
    """The density of the success ratios of an experiment's runs after the same steps; see `SuccessSummary`."""

    __tablename__ = "success_summaries"

    experiment: Mapped[str] = mapped_column(ForeignKey("experiments.hash", ondelete="CASCADE"), primary_key=True)
    steps: Mapped[int] = mapped_column(BigInteger, primary_key=True)
    counting: Mapped[str] = mapped_column(String(8), primary_key=True)  # any or end
    runs: Mapped[int] = mapped_column(Integer)
    bandwidth: Mapped[float] = mapped_column(Float(53))
    mode: Mapped[float] = mapped_column(Float(53))
    modes: Mapped[list[float]] = mapped_column(JSON)
    mean: Mapped[float] = mapped_column(Float(53))
    low: Mapped[float] = mapped_column(Float(53))
    high: Mapped[float] = mapped_column(Float(53))


class SweepRow(Table):
    """A search over the settings of a spec."""

    __tablename__ = "sweeps"

    name: Mapped[str] = mapped_column(String(200), primary_key=True)
    spec_hash: Mapped[str] = mapped_column(String(128))
    storage: Mapped[str] = mapped_column(Text)  # where the sampler keeps its own record of the trials
    created: Mapped[str] = mapped_column(String(32))


class TrialRow(Table):
    """One trial of a sweep: its runs, one per seed, and what they came to."""

    __tablename__ = "trials"

    sweep: Mapped[str] = mapped_column(ForeignKey("sweeps.name", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(Integer, primary_key=True)
    state: Mapped[str] = mapped_column(String(16))
    value: Mapped[float | None] = mapped_column(Float(53))
    runs: Mapped[list[str]] = mapped_column(JSON)  # no foreign key: a run may go to the trash and come back
