"""Whether a user may have one more job."""

from footlight_server.sessions.errors import QuotaError
from footlight_server.settings import Quota


def check_quota(quota: Quota, user: str, jobs_open: int, tasks_open: int, more_tasks: int) -> None:
    """One more job of `more_tasks` tasks, for a user who has so many that have not ended. Raises QuotaError."""
    if quota.jobs and jobs_open >= quota.jobs:
        raise QuotaError(f"{user} has {jobs_open} jobs that have not ended; {quota.jobs} are allowed")
    if quota.tasks and tasks_open + more_tasks > quota.tasks:
        raise QuotaError(
            f"{user} has {tasks_open} tasks that have not ended, and these would be {more_tasks} more; "
            f"{quota.tasks} are allowed"
        )
