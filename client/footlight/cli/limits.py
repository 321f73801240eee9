"""`footlight limits`: what may run at the same time."""

from footlight.cli.connect import connect
from footlight.cli.options import Connection
from footlight.cli.report import note
from footlight.cli.tables import write_json, write_table
from footlight.plain import plain
from footlight.v1 import job_pb2

_UNITS = {job_pb2.LIMIT_UNIT_TASK: "task", job_pb2.LIMIT_UNIT_HOST: "host"}


def run_limits(connection: Connection, name: str, most: int | None, per: str | None, *, as_json: bool) -> None:
    """Set the limit if it is named, what it counts only if that is said; else print all of them."""
    with connect(connection) as client:
        limits = client.farm.limits()
        if most is not None:
            before = next((_UNITS.get(limit.unit) for limit in limits if limit.name == name), None)
            limits = [client.farm.set_limit(name, most, hosts=(per or before) == "host")]
    if as_json:
        write_json([plain(limit) for limit in limits])
        return
    rows = [(limit.name, str(limit.most), _UNITS.get(limit.unit, ""), str(limit.running)) for limit in limits]
    write_table(("LIMIT", "MOST", "PER", "RUNNING"), rows, right=("MOST", "RUNNING"))
    if not limits:
        note("no limits; `footlight limits NAME N` makes one")
