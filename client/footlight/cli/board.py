"""What is known of a job that is watched: its numbers, what runs, and what is worth a line."""

from datetime import UTC, datetime

from footlight.cli.report import duration
from footlight.cli.words import complaint, count, job_word, task_word, what
from footlight.job_calls import has_ended
from footlight.names import short
from footlight.paths import PathMap
from footlight.v1 import job_pb2

# [frames] Before the pace says anything about the rest.
FIRST_PACE = 0.5

_QUIET = {job_pb2.EXIT_CLASS_UNSPECIFIED, job_pb2.EXIT_CLASS_SUCCEEDED, job_pb2.EXIT_CLASS_CANCELLED}


class Board:
    """Takes the events of one job in. `running` are tasks by name; `last_path` is the newest image, as we see it."""

    def __init__(self, paths: PathMap) -> None:
        self.job: job_pb2.Job | None = None
        self.running: dict[str, job_pb2.Task] = {}
        self.last_path = ""
        self._paths = paths
        self._now: datetime | None = None
        self._told: set[str] = set()

    def take(self, event: job_pb2.JobEvent) -> list[str]:
        """Take it in. Lines that are worth saying: a new state, an attempt that came to no good end."""
        if event.HasField("time"):
            self._now = event.time.ToDatetime(UTC)
        match event.WhichOneof("event"):
            case "changed":
                before, self.job = self.job, event.changed
                word = job_word(event.changed)
                return [] if before is not None and job_word(before) == word else [f"{event.changed.name}: {word}"]
            case "task":
                return self._task(event.task)
            case "progress":
                self.running[event.progress.name] = event.progress
            case "frame":
                self.last_path = self._paths.to_client(event.frame.path)
        return []

    def _task(self, task: job_pb2.Task) -> list[str]:
        if task.state == job_pb2.TASK_STATE_RUNNING:
            self.running[task.name] = task
        else:
            self.running.pop(task.name, None)
        attempt = task.last_attempt
        if attempt.exit_class in _QUIET or attempt.name in self._told:
            return []
        self._told.add(attempt.name)
        outlook = task_word(task) if task.state == job_pb2.TASK_STATE_FAILED else "will be tried again"
        return [f"{what(task)}: {complaint(attempt)} ({attempt.worker}); {outlook}"]

    def numbers(self) -> str:
        """`12 of 50 frames, 2 running, 1 failed, about 3:10 left`."""
        if self.job is None:
            return ""
        job = self.job
        parts = [f"{job.frames_done} of {count(job.frames_total, 'frame')}"]
        parts += [
            f"{number} {word}"
            for number, word in ((job.tasks.running, "running"), (job.tasks.failed, "failed"))
            if number
        ]
        remaining = self.remaining()
        return ", ".join([*parts, *([f"about {duration(remaining)} left"] if remaining else [])])

    def remaining(self) -> float | None:
        """[s] At the pace so far, by the server's clock; None if there is no pace yet, or nothing runs."""
        job = self.job
        if job is None or self._now is None or not job.tasks.running or has_ended(job):
            return None
        done = job.frames_done + sum(map(self._begun, self.running.values()))
        elapsed = (self._now - job.start_time.ToDatetime(UTC)).total_seconds()
        if done < FIRST_PACE or elapsed <= 0:
            return None
        return float(max(job.frames_total - done, 0.0) * elapsed / done)

    def _begun(self, task: job_pb2.Task) -> float:
        """[frames] What a running task has of the frame at hand."""
        if self.job is None or not task.progress.samples_total:
            return 0.0
        split = next((layer.split for layer in self.job.spec.layers if layer.name == task.layer), 1)
        return float(task.progress.samples_done / task.progress.samples_total / max(split, 1))

    def summary(self) -> str:
        """What came of it, once it has ended."""
        job = self.job
        if job is None or not has_ended(job):
            return ""
        took = (job.end_time.ToDatetime() - job.start_time.ToDatetime()).total_seconds()
        time = f" in {duration(took)}" if job.HasField("start_time") and job.HasField("end_time") else ""
        return f"{short(job.name)} {job.spec.title}: {job_word(job)}, {self.numbers()}{time}"
