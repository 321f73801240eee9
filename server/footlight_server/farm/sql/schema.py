"""The tables of the queue. Times are [s since 1970, UTC]; states and kinds are the words of farm/model.py.

What is asked for often is kept rather than counted: a job's tasks by state, a layer's tasks that are left, and how
many things each task, layer and job still waits for (`unmet`). A task waits if any of the three is above zero. A layer
that waits for a layer is one row, and so is a job that waits for a job, however many tasks they have.
"""

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Double,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    Text,
    text,
)
from sqlalchemy.types import TypeEngine

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "pk": "pk_%(table_name)s",
    }
)

# SQLite numbers rows by itself in a column of exactly this type only.
Id: TypeEngine[int] = BigInteger().with_variant(Integer, "sqlite")
# Sorted by code points in both databases.
Name: TypeEngine[str] = Text().with_variant(Text(collation="C"), "postgresql")


def _of_job(*, primary_key: bool = True) -> Column[int]:
    """The job a row goes with, and goes away with."""
    key = ForeignKey("job.number", ondelete="CASCADE")
    return Column("job", Id, key, primary_key=primary_key, nullable=False)


def _word(name: str) -> Column[str]:
    return Column(name, Text, nullable=False, server_default="")


def _count(name: str) -> Column[int]:
    return Column(name, Integer, nullable=False, server_default=text("0"))


job = Table(
    "job",
    metadata,
    Column("number", Id, primary_key=True),
    Column("title", Text, nullable=False),
    Column("user", Text, nullable=False),
    Column("state", Text, nullable=False),
    Column("paused", Boolean, nullable=False),
    Column("cancelling", Boolean, nullable=False, server_default=text("false")),
    Column("priority", Integer, nullable=False),
    Column("retries", Integer, nullable=False),
    _word("show"),
    _word("shot"),
    _word("request_id"),
    Column("created", Double, nullable=False),
    Column("started", Double),
    Column("ended", Double),
    # [jobs] It waits for.
    _count("unmet"),
    # [tasks] By state.
    _count("blocked"),
    _count("ready"),
    _count("running"),
    _count("succeeded"),
    _count("failed"),
    _count("skipped"),
    _count("cancelled"),
    # [frames] With an image, and in all.
    _count("frames_done"),
    _count("frames_total"),
    # [s]
    Column("render_seconds", Double, nullable=False, server_default=text("0")),
    # Numbers are never given twice, though jobs are pruned.
    sqlite_autoincrement=True,
)
# The words of these conditions have to be repeated where an index shall be used.
OPEN_FOR_CLAIMS = "ready > 0 AND NOT paused"
Index(
    "ix_job_claim",
    job.c.priority.desc(),
    job.c.number,
    sqlite_where=text(OPEN_FOR_CLAIMS),
    postgresql_where=text(OPEN_FOR_CLAIMS),
)
IS_OPEN = "ended IS NULL"
Index("ix_job_open", job.c.user, sqlite_where=text(IS_OPEN), postgresql_where=text(IS_OPEN))
GIVEN_REQUEST = "request_id <> ''"
Index(
    "ix_job_request",
    job.c.user,
    job.c.request_id,
    unique=True,
    sqlite_where=text(GIVEN_REQUEST),
    postgresql_where=text(GIVEN_REQUEST),
)

# Apart from the job, whose row changes with every task.
job_spec = Table("job_spec", metadata, _of_job(), Column("spec", LargeBinary, nullable=False))

job_tag = Table("job_tag", metadata, _of_job(), Column("tag", Text, primary_key=True))
Index(None, job_tag.c.tag)

job_bundle = Table("job_bundle", metadata, _of_job(), Column("digest", Text, primary_key=True))

# `needs` is another job, which may be pruned once it has succeeded.
job_need = Table("job_need", metadata, _of_job(), Column("needs", Id, primary_key=True))
Index(None, job_need.c.needs)

layer = Table(
    "layer",
    metadata,
    _of_job(),
    # Counts from 0.
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("name", Name, nullable=False),
    # [tasks] In all, and neither succeeded nor skipped.
    Column("total", Integer, nullable=False),
    Column("tasks_left", Integer, nullable=False),
    # [layers] It waits for.
    _count("unmet"),
)

layer_spec = Table(
    "layer_spec",
    metadata,
    _of_job(),
    Column("layer", Integer, primary_key=True, autoincrement=False),
    Column("spec", LargeBinary, nullable=False),
)

layer_need = Table(
    "layer_need",
    metadata,
    _of_job(),
    Column("layer", Integer, primary_key=True, autoincrement=False),
    Column("needs", Integer, primary_key=True, autoincrement=False),
)

layer_limit = Table(
    "layer_limit",
    metadata,
    _of_job(),
    Column("layer", Integer, primary_key=True, autoincrement=False),
    Column("name", Text, primary_key=True),
)

task = Table(
    "task",
    metadata,
    _of_job(),
    # Counts from 1.
    Column("number", Integer, primary_key=True, autoincrement=False),
    # The layer's number.
    Column("layer", Integer, nullable=False),
    Column("kind", Text, nullable=False),
    # What it makes is merged by another task.
    Column("part", Boolean, nullable=False),
    # A JSON list.
    Column("frames", Text, nullable=False),
    Column("sample_begin", BigInteger, nullable=False),
    Column("sample_end", BigInteger, nullable=False),
    Column("state", Text, nullable=False),
    # [tasks] It waits for.
    _count("unmet"),
    _count("failures"),
    _count("losses"),
    _count("attempt"),
    Column("not_before", Double, nullable=False, server_default=text("0")),
    _word("stop"),
    _count("frames_done"),
    # Kept by rowid: were it kept by its key, SQLite would walk along that, past all tasks that have ended, to find the
    # first that is ready.
)
Index(None, task.c.job, task.c.state, task.c.number)
IS_READY = "state = 'ready'"
# Serves the order of claims within a layer.
Index(
    "ix_task_claim",
    task.c.job,
    task.c.layer,
    task.c.number,
    task.c.not_before,
    sqlite_where=text(IS_READY),
    postgresql_where=text(IS_READY),
)
IS_DELAYED = "state = 'ready' AND not_before > 0"
Index("ix_task_delayed", task.c.not_before, sqlite_where=text(IS_DELAYED), postgresql_where=text(IS_DELAYED))

task_need = Table(
    "task_need",
    metadata,
    _of_job(),
    Column("task", Integer, primary_key=True, autoincrement=False),
    Column("needs", Integer, primary_key=True, autoincrement=False),
    sqlite_with_rowid=False,
)
Index(None, task_need.c.job, task_need.c.needs)

attempt = Table(
    "attempt",
    metadata,
    _of_job(),
    Column("task", Integer, primary_key=True, autoincrement=False),
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("worker", Text, nullable=False),
    Column("host", Text, nullable=False),
    Column("started", Double, nullable=False),
    Column("ended", Double),
    Column("exit_class", Text),
    _word("message"),
    _word("prim_path"),
    Column("peak_memory_bytes", BigInteger, nullable=False, server_default=text("0")),
    sqlite_with_rowid=False,
)
IS_RUNNING = "ended IS NULL"
Index(
    "ix_attempt_running",
    attempt.c.job,
    attempt.c.task,
    sqlite_where=text(IS_RUNNING),
    postgresql_where=text(IS_RUNNING),
)

# Where a task failed for a reason that may be the lane's.
lane_failure = Table(
    "lane_failure",
    metadata,
    _of_job(),
    Column("task", Integer, primary_key=True, autoincrement=False),
    Column("lane", Text, primary_key=True),
)

# How many different tasks of the job that were.
lane_blame = Table(
    "lane_blame",
    metadata,
    _of_job(),
    Column("lane", Text, primary_key=True),
    Column("tasks", Integer, nullable=False),
)
Index(None, lane_blame.c.lane)

_IMAGE = (
    ("layer", Name),
    ("path", Text),
    ("sha256", Text),
    ("size_bytes", BigInteger),
    ("attempt", Integer),
    ("stats", LargeBinary),
)


def _image_columns() -> list[Column[object]]:
    return [Column(name, kind, nullable=False) for name, kind in _IMAGE]


frame = Table(
    "frame",
    metadata,
    _of_job(),
    Column("task", Integer, primary_key=True, autoincrement=False),
    Column("frame", Integer, primary_key=True, autoincrement=False),
    Column("part", Boolean, nullable=False),
    *_image_columns(),
)
IS_IMAGE = "NOT part"
Index(
    "ix_frame_image",
    frame.c.job,
    frame.c.layer,
    frame.c.frame,
    unique=True,
    sqlite_where=text(IS_IMAGE),
    postgresql_where=text(IS_IMAGE),
)

# What is about to be renamed.
staged_frame = Table(
    "staged_frame",
    metadata,
    _of_job(),
    Column("task", Integer, primary_key=True, autoincrement=False),
    Column("frame", Integer, primary_key=True, autoincrement=False),
    *_image_columns(),
    Column("temp_path", Text, nullable=False),
)

# Only ever appended to, and pruned with the job.
event = Table(
    "event",
    metadata,
    Column("id", Id, primary_key=True),
    Column("time", Double, nullable=False),
    _of_job(primary_key=False),
    Column("kind", Text, nullable=False),
    Column("task", Integer),
    _word("layer"),
    Column("frame", Integer),
    _word("state"),
    # Ids are never given twice, though events are pruned.
    sqlite_autoincrement=True,
)
Index(None, event.c.job, event.c.id)

limit = Table(
    "limit",
    metadata,
    Column("name", Text, primary_key=True),
    Column("most", BigInteger, nullable=False),
    Column("unit", Text, nullable=False),
)

token = Table(
    "token",
    metadata,
    Column("number", Id, primary_key=True),
    Column("hash", Text, nullable=False, unique=True),
    Column("user", Text, nullable=False),
    Column("scope", Text, nullable=False),
    _word("comment"),
    Column("created", Double, nullable=False),
    Column("expires", Double),
    Column("revoked", Double),
    Column("last_used", Double),
    sqlite_autoincrement=True,
)
