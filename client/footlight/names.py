"""Names of jobs, tasks and attempts, from what people type: `12`, `12/3`, `jobs/12/tasks/3`."""

import re

_JOB = re.compile(r"(?:jobs/)?(\d{1,18})")
_TASK = re.compile(r"(?:jobs/)?(\d{1,18})/(?:tasks/)?(\d{1,18})")
_ATTEMPT = re.compile(r"(?:jobs/)?(\d{1,18})/(?:tasks/)?(\d{1,18})/(?:attempts/)?(\d{1,18})")
_TOKEN = re.compile(r"(?:tokens/)?(\d{1,18})")


def job_name(text: str | int) -> str:
    """`jobs/12` for 12, `12`, `jobs/12`. Raises ValueError."""
    if found := _JOB.fullmatch(str(text)):
        return f"jobs/{int(found[1])}"
    raise ValueError(f"job: {text!r} is not a job; write 12 or jobs/12")


def task_name(text: str) -> str:
    """`jobs/12/tasks/3` for `12/3` and itself. Raises ValueError."""
    if found := _TASK.fullmatch(text):
        return f"jobs/{int(found[1])}/tasks/{int(found[2])}"
    raise ValueError(f"task: {text!r} is not a task; write 12/3 or jobs/12/tasks/3")


def job_or_task_name(text: str) -> str:
    """Whichever it is. Raises ValueError."""
    for form in (job_name, task_name):
        try:
            return form(text)
        except ValueError:
            continue
    raise ValueError(f"job: {text!r} is neither a job (12, jobs/12) nor a task (12/3, jobs/12/tasks/3)")


def attempt_or_task_name(text: str) -> str:
    """`jobs/12/tasks/3/attempts/1` for `12/3/1`, or a task. Raises ValueError."""
    if found := _ATTEMPT.fullmatch(text):
        return f"jobs/{int(found[1])}/tasks/{int(found[2])}/attempts/{int(found[3])}"
    return task_name(text)


def token_name(text: str) -> str:
    """`tokens/3` for `3` and itself. Raises ValueError."""
    if found := _TOKEN.fullmatch(text):
        return f"tokens/{int(found[1])}"
    raise ValueError(f"token: {text!r} is not a token; write 3 or tokens/3, as `footlight token list` shows them")


def job_of(name: str) -> str:
    """The job that a task or attempt belongs to; a job itself."""
    return "/".join(name.split("/")[:2])


def number_of(name: str) -> int:
    """The last number of a name: 3 for `jobs/12/tasks/3`."""
    return int(name.rpartition("/")[2])


def short(name: str) -> str:
    """As people type it: `12/3` for `jobs/12/tasks/3`."""
    return "/".join(name.split("/")[1::2])
