"""From the queue's plain values to the protocol's messages."""

from google.protobuf.timestamp_pb2 import Timestamp

from footlight.v1 import job_pb2, stats_pb2
from footlight_server.api.names import attempt_name, job_name, task_name
from footlight_server.farm.attempt import Running
from footlight_server.farm.model import Attempt, Frame, Job, JobState, Limit, LimitUnit, Task, TaskState

JOB_STATES = {job_pb2.JobState.Value(f"JOB_STATE_{state.name}"): state for state in JobState}
TASK_STATES = {job_pb2.TaskState.Value(f"TASK_STATE_{state.name}"): state for state in TaskState}
LIMIT_UNITS = {job_pb2.LimitUnit.Value(f"LIMIT_UNIT_{unit.name}"): unit for unit in LimitUnit}


def timestamp(seconds: float) -> Timestamp:
    """Of a time [s since 1970, UTC], to the microsecond."""
    stamp = Timestamp()
    stamp.FromMicroseconds(round(seconds * 1e6))
    return stamp


def job_message(job: Job) -> job_pb2.Job:
    """A job; one that is not in the queue, number 0, has no name."""
    message = job_pb2.Job(
        name=job_name(job.number) if job.number else "",
        spec=job_pb2.JobSpec.FromString(job.spec),
        state=job_pb2.JobState.Value(f"JOB_STATE_{job.state.name}"),
        paused=job.paused,
        user=job.user,
        create_time=timestamp(job.created),
        tasks=counts_message(job),
        frames_done=job.frames_done,
        frames_total=job.frames_total,
        render_seconds=job.render_seconds,
    )
    if job.started is not None:
        message.start_time.CopyFrom(timestamp(job.started))
    if job.ended is not None:
        message.end_time.CopyFrom(timestamp(job.ended))
    return message


def counts_message(job: Job) -> job_pb2.TaskCounts:
    """Its tasks by state."""
    return job_pb2.TaskCounts(**{state.value: getattr(job.counts, state.value) for state in TaskState})


def task_message(task: Task, running: Running | None, log_bytes: int) -> job_pb2.Task:
    """A task. `running`: the attempt at it that runs, if one does; `log_bytes`: of its last attempt's log."""
    message = job_pb2.Task(
        name=task_name(task.job, task.number),
        layer=task.layer,
        kind=job_pb2.TaskKind.Value(f"TASK_KIND_{task.kind.name}"),
        frames=task.frames,
        sample_begin=task.sample_begin,
        sample_end=task.sample_end,
        state=job_pb2.TaskState.Value(f"TASK_STATE_{task.state.name}"),
        frames_done=task.frames_done,
        failures=task.failures,
        attempts=task.attempt,
    )
    if task.last_attempt is not None:
        message.last_attempt.CopyFrom(attempt_message(task.last_attempt, running, log_bytes))
    if task.state is TaskState.RUNNING and running is not None and running.progress is not None:
        message.progress.CopyFrom(running.progress)
    if task.not_before and task.state is TaskState.READY:
        message.not_before.CopyFrom(timestamp(task.not_before))
    return message


def attempt_message(attempt: Attempt, running: Running | None, log_bytes: int) -> job_pb2.Attempt:
    """An attempt. `running`: the attempt at its task that runs, this one or another."""
    message = job_pb2.Attempt(
        name=attempt_name(attempt.job, attempt.task, attempt.number),
        worker=attempt.worker,
        host=attempt.host,
        start_time=timestamp(attempt.started),
        message=attempt.message,
        prim_path=attempt.prim_path,
        peak_memory_bytes=attempt.peak_memory_bytes,
        log_bytes=log_bytes,
    )
    if attempt.ended is not None:
        message.end_time.CopyFrom(timestamp(attempt.ended))
    if attempt.exit_class is not None:
        message.exit_class = job_pb2.ExitClass.Value(f"EXIT_CLASS_{attempt.exit_class.name}")
    elif running is not None and running.attempt.number == attempt.number:
        message.render = running.render
    return message


def frame_message(frame: Frame) -> job_pb2.Frame:
    """The image of a frame."""
    return job_pb2.Frame(
        layer=frame.layer,
        frame=frame.frame,
        path=frame.path,
        sha256=frame.sha256,
        size_bytes=frame.size_bytes,
        attempt=attempt_name(frame.job, frame.task, frame.attempt),
        stats=stats_pb2.RenderStats.FromString(frame.stats),
    )


def limit_message(limit: Limit) -> job_pb2.Limit:
    """A limit."""
    unit = job_pb2.LimitUnit.Value(f"LIMIT_UNIT_{limit.unit.name}")
    return job_pb2.Limit(name=limit.name, most=limit.most, unit=unit, running=limit.running)
