"""Whose a resource is, and who may steer it; the scope of the call was checked before."""

from footlight_server.api.auth import Caller
from footlight_server.sessions.errors import NotYoursError


def check_owner(caller: Caller, user: str, name: str) -> None:
    """`name` belongs to `user`. Raises NotYoursError unless that is the caller, or the caller is an admin."""
    if not caller.is_admin and caller.user != user:
        raise NotYoursError(f"{name} is {user}'s")
