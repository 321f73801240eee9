"""Brings a database to this program's revision, with a copy of it beside it first."""

import logging
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection

from footlight_server.farm.sql.database import Database, check_integrity
from footlight_server.farm.sql.ownership import make_private
from footlight_server.sessions.errors import DatabaseRefusedError

log = logging.getLogger(__name__)


def migrate(database: Database) -> None:
    """Make the tables, or change them to what this program uses; all of it or nothing.

    Raises DatabaseRefusedError for a database of a newer program, or one that is damaged.
    """
    with database.connected() as connection:
        found = revision_of(connection)
    scripts = ScriptDirectory.from_config(_config())
    head = scripts.get_current_head()
    if found == head:
        return
    if found is not None and found not in {script.revision for script in scripts.walk_revisions()}:
        raise DatabaseRefusedError(f"the database is of a newer version (revision {found}; this one knows {head})")
    if found is not None and database.path is not None:
        back_up(database, database.path.with_name(f"{database.path.name}.{found}.backup"))
    with database.connected() as connection:
        check_integrity(connection)
        upgrade(connection)
        check_integrity(connection)
    log.info("the database is at revision %s, from %s", head, found or "nothing")


def back_up(database: Database, copy: Path) -> None:
    """Write a copy of an SQLite database as it is; one of that name is replaced when the new one is whole."""
    new = copy.with_name(f"{copy.name}.new")
    new.unlink(missing_ok=True)
    make_private(new)
    database.vacuum_into(new)
    new.replace(copy)


def revision_of(connection: Connection) -> str | None:
    """The revision the database is at; None for an empty one."""
    return MigrationContext.configure(connection).get_current_revision()


def upgrade(connection: Connection, revision: str = "head") -> None:
    """To a revision, in the caller's transaction."""
    command.upgrade(_config(connection), revision)


def downgrade(connection: Connection, revision: str) -> None:
    """Back to a revision, in the caller's transaction; `base` is before the first."""
    command.downgrade(_config(connection), revision)


def _config(connection: Connection | None = None) -> Config:
    config = Config()
    # Percent signs mean something to it.
    folder = str(Path(__file__).with_name("migrations")).replace("%", "%%")
    config.set_main_option("script_location", folder)
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    return config
