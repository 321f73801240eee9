"""Resource names of the queue: `jobs/{id}`, `jobs/{id}/tasks/{number}`, `…/attempts/{number}`, to numbers and back."""

import re

from footlight_server.sessions.errors import JobNotFoundError, TaskNotFoundError

# [digits] What a database's integer holds for certain.
_NUMBER = "([1-9][0-9]{0,17})"
_JOB = re.compile(f"jobs/{_NUMBER}", re.ASCII)
_TASK = re.compile(f"jobs/{_NUMBER}/tasks/{_NUMBER}", re.ASCII)
_ATTEMPT = re.compile(f"jobs/{_NUMBER}/tasks/{_NUMBER}/attempts/{_NUMBER}", re.ASCII)


def job_name(job: int) -> str:
    """`jobs/{id}`."""
    return f"jobs/{job}"


def task_name(job: int, task: int) -> str:
    """`jobs/{id}/tasks/{number}`."""
    return f"jobs/{job}/tasks/{task}"


def attempt_name(job: int, task: int, attempt: int) -> str:
    """`jobs/{id}/tasks/{number}/attempts/{number}`."""
    return f"jobs/{job}/tasks/{task}/attempts/{attempt}"


def job_number(name: str) -> int:
    """The job's number. Raises JobNotFoundError if it is no name of one."""
    match = _JOB.fullmatch(name)
    if match is None:
        raise JobNotFoundError(f"no job {name[:100]!r}; a name is jobs/12")
    return int(match[1])


def task_numbers(name: str) -> tuple[int, int]:
    """Job and task. Raises TaskNotFoundError if it is no name of a task."""
    match = _TASK.fullmatch(name)
    if match is None:
        raise TaskNotFoundError(f"no task {name[:100]!r}; a name is jobs/12/tasks/3")
    return int(match[1]), int(match[2])


def attempt_numbers(name: str) -> tuple[int, int, int | None]:
    """Job, task and attempt; for the name of a task no attempt. Raises TaskNotFoundError if it is neither."""
    if match := _ATTEMPT.fullmatch(name):
        return int(match[1]), int(match[2]), int(match[3])
    return (*task_numbers(name), None)


def is_task_name(name: str) -> bool:
    """Whether it names a task rather than a job."""
    return _TASK.fullmatch(name) is not None
