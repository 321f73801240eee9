"""Named limits: what runs under each, and which leave no room."""

from collections import Counter
from dataclasses import dataclass, field

from sqlalchemy import Connection, and_, delete, func, insert, select

from footlight_server.farm.model import Limit, LimitUnit
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.transaction import Transaction

_attempt, _task, _of = schema.attempt.c, schema.task.c, schema.layer_limit.c

_SELECT_LIMITS = select(schema.limit).order_by(schema.limit.c.name)
# As many rows as there are running tasks, at most: lanes, not tasks.
_SELECT_RUNNING = (
    select(_of.name, _attempt.host, func.count())
    .select_from(
        schema.attempt.join(schema.task, and_(_task.job == _attempt.job, _task.number == _attempt.task)).join(
            schema.layer_limit, and_(_of.job == _task.job, _of.layer == _task.layer)
        )
    )
    .where(_attempt.ended.is_(None))
    .group_by(_of.name, _attempt.host)
)


@dataclass(slots=True)
class _Load:
    """A limit, and its running tasks by host."""

    name: str
    most: int
    unit: LimitUnit
    hosts: Counter[str] = field(default_factory=Counter)

    @property
    def running(self) -> int:
        return self.hosts.total() if self.unit is LimitUnit.TASK else len(self.hosts)

    def is_full(self, host: str) -> bool:
        """One more task on that host would be too much."""
        if self.unit is LimitUnit.HOST and host in self.hosts:
            return self.running > self.most
        return self.running >= self.most


def full_limits(connection: Connection, host: str) -> list[str]:
    """Names of the limits that leave no room for one more task on a host."""
    return [load.name for load in _loads(connection) if load.is_full(host)]


def limits(connection: Connection) -> list[Limit]:
    """See Queue.limits."""
    return [Limit(load.name, load.most, load.unit, load.running) for load in _loads(connection)]


def set_limit(transaction: Transaction, limit: Limit) -> Limit:
    """See Queue.set_limit."""
    table = schema.limit
    transaction.connection.execute(delete(table).where(table.c.name == limit.name))
    transaction.connection.execute(insert(table).values(name=limit.name, most=limit.most, unit=limit.unit.value))
    transaction.rings = True
    return next(kept for kept in limits(transaction.connection) if kept.name == limit.name)


def _loads(connection: Connection) -> list[_Load]:
    loads = {row.name: _Load(row.name, row.most, LimitUnit(row.unit)) for row in connection.execute(_SELECT_LIMITS)}
    if loads:
        for name, host, count in connection.execute(_SELECT_RUNNING):
            if name in loads:
                loads[name].hosts[host] += count
    return list(loads.values())
