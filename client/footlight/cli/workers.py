"""`footlight workers`: where tasks can run."""

from footlight.cli.connect import connect
from footlight.cli.options import Connection
from footlight.cli.report import note
from footlight.cli.tables import write_json, write_table
from footlight.names import short
from footlight.plain import plain


def run_workers(connection: Connection, *, as_json: bool) -> None:
    """Print the workers, what they run, and which jobs avoid them."""
    with connect(connection) as client:
        workers = client.farm.workers()
    if as_json:
        write_json([plain(worker) for worker in workers])
        return
    rows = [
        (worker.name, worker.host, short(worker.task) or "idle", ", ".join(short(job) for job in worker.blocked_jobs))
        for worker in workers
    ]
    write_table(("WORKER", "HOST", "TASK", "AVOIDED BY"), rows, fold=("AVOIDED BY",))
    if not workers:
        note("no workers: the server was started with --farm-workers 0, or its nodes are gone")
