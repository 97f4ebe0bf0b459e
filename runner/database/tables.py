"""The tables of the logbook: one fact per row, with its unit.

    sweep --< run --< metric, coefficient, diagnostic, series
    sweep --< planned            (its trials, whether or not they were started)
    sweep --< reuse >-- run      (runs of other sweeps that a sweep uses)

Times are UTC, to the microsecond, without a zone in the column.
"""

from datetime import UTC, datetime

from sqlalchemy import (
    JSON,
    BigInteger,
    CheckConstraint,
    DateTime,
    Dialect,
    Float,
    ForeignKey,
    Index,
    MetaData,
    String,
    Text,
    TypeDecorator,
    UniqueConstraint,
    text,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from seatrial.runner.record.vocabulary import STATUSES

_NAMES = {
    "pk": "pk_%(table_name)s",
    "fk": "fk_%(table_name)s_%(column_0_name)s",
    "uq": "uq_%(table_name)s_%(column_0_name)s",
    "ck": "ck_%(table_name)s_%(constraint_name)s",
    "ix": "ix_%(table_name)s_%(column_0_name)s",
}


class Utc(TypeDecorator[datetime]):
    """An aware time in Python, UTC without a zone in the database."""

    impl = DateTime
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """The time as the database holds it."""
        return value.astimezone(UTC).replace(tzinfo=None) if value is not None else None

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """The time as Python holds it."""
        return value.replace(tzinfo=UTC) if value is not None else None


class Base(DeclarativeBase):
    """All tables of the logbook."""

    metadata = MetaData(naming_convention=_NAMES)
    type_annotation_map = {  # noqa: RUF012 - SQLAlchemy's own form
        datetime: Utc(),
        dict[str, object]: JSON(),
        dict[str, str]: JSON(),
        list[str]: JSON(),
        str: Text(),
        float: Float(),
    }


class SweepRow(Base):
    """One start of the program with several trials."""

    __tablename__ = "sweep"
    __table_args__ = ({"sqlite_autoincrement": True},)  # an id is never used twice

    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str]
    command: Mapped[str]
    overrides: Mapped[list[str]]
    planned: Mapped[int]
    started_at: Mapped[datetime]
    finished_at: Mapped[datetime | None]
    host: Mapped[str]
    pid: Mapped[int]
    tags: Mapped[list[str] | None] = mapped_column(JSON(none_as_null=True))
    note: Mapped[str | None]


class PlannedRow(Base):
    """One trial that a sweep was to run; it never started if no run has its fingerprint."""

    __tablename__ = "planned"

    sweep_id: Mapped[int] = mapped_column(
        ForeignKey("sweep.id", ondelete="CASCADE"), primary_key=True
    )
    fingerprint: Mapped[str] = mapped_column(String(64), primary_key=True, index=True)
    choices: Mapped[dict[str, str]]  # the option of each group
    seed: Mapped[int] = mapped_column(BigInteger)
    overrides: Mapped[list[str]]


class RunRow(Base):
    """One attempt at one trial."""

    __tablename__ = "run"
    __table_args__ = (
        CheckConstraint(f"status IN {STATUSES}", name="status"),
        UniqueConstraint("fingerprint", "attempt"),
        # If two processes start the same trial at once, only one inserts its row.
        Index(
            "uq_run_running",
            "fingerprint",
            unique=True,
            sqlite_where=text("status = 'running'"),
            postgresql_where=text("status = 'running'"),
        ),
        Index("ix_run_status", "status"),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[int] = mapped_column(primary_key=True)
    sweep_id: Mapped[int | None] = mapped_column(ForeignKey("sweep.id"), index=True)
    fingerprint: Mapped[str] = mapped_column(String(64))
    attempt: Mapped[int]
    status: Mapped[str] = mapped_column(String(16))
    error: Mapped[str | None]
    traceback: Mapped[str | None]
    note: Mapped[str | None]
    vessel: Mapped[str]
    disturbance: Mapped[str]
    excitation: Mapped[str]
    identifier: Mapped[str]
    controller: Mapped[str]
    evaluation: Mapped[str]
    seed: Mapped[int] = mapped_column(BigInteger)
    config: Mapped[dict[str, object]]
    overrides: Mapped[list[str]]
    git_commit: Mapped[str | None]
    git_dirty: Mapped[bool | None]
    versions: Mapped[dict[str, object]]
    host: Mapped[str]
    pid: Mapped[int]
    started_at: Mapped[datetime]
    finished_at: Mapped[datetime | None]
    duration_s: Mapped[float | None]
    error_type: Mapped[str | None]
    command: Mapped[str | None]
    heartbeat_at: Mapped[
        datetime | None
    ]  # by the database's clock, because the clocks of hosts differ
    process: Mapped[str | None]  # see claims.py
    code: Mapped[str | None] = mapped_column(String(16))  # digest of the code that computes
    # The fingerprint without the seed: equal for the replicates of one experiment.
    experiment: Mapped[str | None] = mapped_column(String(64))
    # Random streams that the results depend on; NULL if unknown.
    drawn: Mapped[list[str] | None] = mapped_column(JSON(none_as_null=True))


class MetricRow(Base):
    """One figure of merit."""

    __tablename__ = "metric"
    __table_args__ = (UniqueConstraint("run_id", "name", "stage", "model", "dof"),)

    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(ForeignKey("run.id", ondelete="CASCADE"))
    stage: Mapped[str]
    model: Mapped[str]
    dof: Mapped[str]
    name: Mapped[str]
    value: Mapped[float | None]
    unit: Mapped[str]


class CoefficientRow(Base):
    """One entry of a model."""

    __tablename__ = "coefficient"
    __table_args__ = (UniqueConstraint("run_id", "model", "dof", "term"),)

    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(ForeignKey("run.id", ondelete="CASCADE"))
    model: Mapped[str]
    dof: Mapped[str]
    term: Mapped[str]
    value: Mapped[float | None]
    std_error: Mapped[float | None]
    true_value: Mapped[float | None]
    unit: Mapped[str]


class DiagnosticRow(Base):
    """One `Diagnostic` of a part of a trial."""

    __tablename__ = "diagnostic"
    __table_args__ = (Index("ix_diagnostic_run_id", "run_id", "name"),)

    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(ForeignKey("run.id", ondelete="CASCADE"))
    name: Mapped[str]
    dof: Mapped[str]
    i: Mapped[int | None]
    j: Mapped[int | None]
    label: Mapped[str | None]
    value: Mapped[float | None]
    unit: Mapped[str]


class SeriesRow(Base):
    """One kind of series in the file of a run; `path` is relative to the results folder."""

    __tablename__ = "series"
    __table_args__ = (UniqueConstraint("run_id", "kind"),)

    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(ForeignKey("run.id", ondelete="CASCADE"))
    kind: Mapped[str]
    path: Mapped[str]
    n_rows: Mapped[int]
    sha256: Mapped[str] = mapped_column(String(64))
    columns: Mapped[dict[str, str]]  # name: unit


class Reuse(Base):
    """A trial of a sweep that another run has finished or is running."""

    __tablename__ = "reuse"

    sweep_id: Mapped[int] = mapped_column(
        ForeignKey("sweep.id", ondelete="CASCADE"), primary_key=True
    )
    run_id: Mapped[int] = mapped_column(
        ForeignKey("run.id", ondelete="CASCADE"), primary_key=True, index=True
    )
