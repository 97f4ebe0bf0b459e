"""Add the digest of the code, the random streams drawn, and tags and notes of sweeps."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns; of earlier runs they are unknown."""
    with op.batch_alter_table("run") as run:
        run.add_column(sa.Column("code", sa.String(16), nullable=True))
        run.add_column(sa.Column("experiment", sa.String(64), nullable=True))
        run.add_column(sa.Column("drawn", sa.JSON(none_as_null=True), nullable=True))
    with op.batch_alter_table("sweep") as sweep:
        sweep.add_column(sa.Column("tags", sa.JSON(none_as_null=True), nullable=True))
        sweep.add_column(sa.Column("note", sa.Text(), nullable=True))
