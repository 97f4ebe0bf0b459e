"""The environment of Alembic, which runs on a given connection, within its transaction."""

import logging

from alembic import context
from sqlalchemy import Connection

from seatrial.runner.database.schema import VERSION_TABLE
from seatrial.runner.database.tables import Base

logging.getLogger("alembic").setLevel(logging.WARNING)  # `schema` logs the upgrade itself
connection: Connection = context.config.attributes["connection"]
context.configure(
    connection=connection,
    target_metadata=Base.metadata,
    version_table=VERSION_TABLE,
    render_as_batch=connection.dialect.name == "sqlite",
    transactional_ddl=True,
)
context.run_migrations()
