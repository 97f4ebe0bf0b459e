"""Add claims, heartbeats, error types and commands of runs."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns; running runs have no heartbeat and become interrupted."""
    with op.batch_alter_table("run") as run:
        run.add_column(sa.Column("error_type", sa.Text(), nullable=True))
        run.add_column(sa.Column("command", sa.Text(), nullable=True))
        run.add_column(sa.Column("heartbeat_at", sa.DateTime(), nullable=True))
        run.add_column(sa.Column("process", sa.Text(), nullable=True))
    op.execute(
        "UPDATE run SET status = 'interrupted', error = 'under way when the logbook was upgraded'"
        " WHERE status = 'running'"
    )
    running = sa.text("status = 'running'")
    op.create_index(
        "uq_run_running",
        "run",
        ["fingerprint"],
        unique=True,
        sqlite_where=running,
        postgresql_where=running,
    )
    op.create_index("ix_run_status", "run", ["status"])
    _reuse()


def _reuse() -> None:
    op.create_table(
        "reuse",
        sa.Column("sweep_id", sa.Integer(), nullable=False),
        sa.Column("run_id", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["sweep_id"], ["sweep.id"], name="fk_reuse_sweep_id", ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name="fk_reuse_run_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("sweep_id", "run_id", name="pk_reuse"),
    )
    op.create_index("ix_reuse_run_id", "reuse", ["run_id"])
