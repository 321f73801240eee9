"""What Alembic runs for each migration; the connection comes from farm/sql/migrate.py."""

from alembic import context

from footlight_server.farm.sql.schema import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,
    # All of it or nothing, in SQLite too: the transaction is the caller's.
    transactional_ddl=True,
)
context.run_migrations()
