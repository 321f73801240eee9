"""Jobs, tasks and attempts in words for people."""

from datetime import UTC, datetime

from footlight.cli.progress import describe
from footlight.cli.report import duration
from footlight.job_calls import has_ended
from footlight.names import short
from footlight.v1 import job_pb2, token_service_pb2

# [frames] Of a task, before they are shortened to first and last.
FEW = 3


def job_word(job: job_pb2.Job) -> str:
    """The state, or `paused` for a job that waits for being resumed."""
    if job.paused and job.state == job_pb2.JOB_STATE_QUEUED:
        return "paused"
    name: str = job_pb2.JobState.Name(job.state)
    word = name.removeprefix("JOB_STATE_").lower()
    return f"{word}, paused" if job.paused and not has_ended(job) else word


def task_word(task: job_pb2.Task) -> str:
    """The state."""
    name: str = job_pb2.TaskState.Name(task.state)
    return name.removeprefix("TASK_STATE_").lower()


def exit_word(attempt: job_pb2.Attempt) -> str:
    """How an attempt ended: `out of memory`; `running` while it has not."""
    if attempt.exit_class == job_pb2.EXIT_CLASS_UNSPECIFIED:
        return "running"
    name: str = job_pb2.ExitClass.Name(attempt.exit_class)
    return name.removeprefix("EXIT_CLASS_").lower().replace("_", " ")


def scope_word(scope: int) -> str:
    """The scope of a token."""
    name: str = token_service_pb2.Scope.Name(scope)
    return name.removeprefix("SCOPE_").lower()


def frames_of(task: job_pb2.Task) -> str:
    """`1001`, `1001,1002`, `1001…1010 (10)`."""
    if len(task.frames) <= FEW:
        return ",".join(map(str, task.frames))
    return f"{task.frames[0]}…{task.frames[-1]} ({len(task.frames)})"


def what(task: job_pb2.Task, spp: int = 0) -> str:
    """A task as one says it: `12/7 main 1007`, with its samples if they are not all `spp` of them, or `merge`."""
    text = f"{short(task.name)} {task.layer} {frames_of(task)}"
    if task.kind == job_pb2.TASK_KIND_MERGE:
        return f"{text} merge"
    return f"{text} samples {samples_of(task)}" if spp and task.sample_end - task.sample_begin != spp else text


def samples_of(task: job_pb2.Task) -> str:
    """`0-16`."""
    return f"{task.sample_begin}-{task.sample_end}"


def complaint(attempt: job_pb2.Attempt) -> str:
    """Why an attempt did not succeed: `crash: the worker died of SIGSEGV`, with the prim at fault."""
    prim = f"{attempt.prim_path}: " if attempt.prim_path and attempt.prim_path not in attempt.message else ""
    text = f"{prim}{attempt.message}"
    return f"{exit_word(attempt)}: {text}" if text else exit_word(attempt)


def progress_of(task: job_pb2.Task) -> str:
    """How far a running task is with the frame at hand."""
    return describe(task.progress) if task.progress.samples_total else "opening"


def moment(message: object, field: str) -> str:
    """A time as the clock here shows it: `2026-11-22 14:03:07`; empty if it is not set."""
    time = when(message, field)
    return time.astimezone().strftime("%Y-%m-%d %H:%M:%S") if time else ""


def lasted(message: job_pb2.Job | job_pb2.Attempt) -> str:
    """From start to end; empty if one of them is not known."""
    start, end = when(message, "start_time"), when(message, "end_time")
    return duration((end - start).total_seconds()) if start and end else ""


def when(message: object, field: str) -> datetime | None:
    """The time in a field, in UTC; None if it is not set."""
    if not message.HasField(field):  # type: ignore[attr-defined]
        return None
    time: datetime = getattr(message, field).ToDatetime(UTC)
    return time


def count(number: int, noun: str) -> str:
    """`1 frame`, `2 frames`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def size(number: int) -> str:
    """[bytes] `512 B`, `1.2 MB`, `34 GB`."""
    value, units = float(number), ["B", "KB", "MB", "GB", "TB"]
    while value >= 999.5 and len(units) > 1:
        value /= 1000.0
        units.pop(0)
    return f"{value:.0f} {units[0]}" if value >= 9.95 or units[0] == "B" else f"{value:.1f} {units[0]}"
