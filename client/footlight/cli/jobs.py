"""`footlight jobs`: the queue as a table."""

import sys
from typing import Any

from footlight.cli.connect import connect
from footlight.cli.options import Connection
from footlight.cli.report import note, usage
from footlight.cli.tables import write_json, write_table
from footlight.cli.words import job_word, lasted, moment
from footlight.names import short
from footlight.plain import plain

COLUMNS = ("JOB", "STATE", "TITLE", "SHOW", "SHOT", "USER", "PRIO", "FRAMES", "FAILED", "SUBMITTED", "TIME")
# Of `2026-11-22 14:03:07`, where there is little room.
_DAY_TO_MINUTE = slice(5, 16)


def run_jobs(connection: Connection, count: int, *, as_json: bool, **choice: Any) -> None:
    """Print the newest `count` jobs of the choice of Farm.jobs."""
    with connect(connection) as client, usage():
        jobs = client.farm.jobs(count, **choice)
    if as_json:
        write_json([plain(job) for job in jobs])
        return
    rows = [
        (
            short(job.name),
            job_word(job),
            job.spec.title,
            job.spec.show,
            job.spec.shot,
            job.user,
            str(job.spec.priority),
            f"{job.frames_done}/{job.frames_total}",
            str(job.tasks.failed or ""),
            moment(job, "create_time")[_DAY_TO_MINUTE if sys.stdout.isatty() else slice(None)],
            lasted(job),
        )
        for job in jobs
    ]
    write_table(COLUMNS, rows, right=("PRIO", "FRAMES", "FAILED", "TIME"), cut=("TITLE", "SHOW", "SHOT"))
    if not jobs:
        note("no jobs")
    elif len(jobs) == count:
        note(f"the newest {count}; --count N shows more")
