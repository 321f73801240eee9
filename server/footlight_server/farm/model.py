"""The nouns of the queue: job, layer, task, attempt, frame, event, as plain values."""

from dataclasses import dataclass, field
from enum import StrEnum


class JobState(StrEnum):
    """As in the protocol; stored by these words."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLING = "cancelling"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        """Nothing happens any more, unless tasks are retried."""
        return self in {JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELLED}


class TaskState(StrEnum):
    """As in the protocol; stored by these words."""

    BLOCKED = "blocked"
    READY = "ready"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    SKIPPED = "skipped"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        """No worker will take it up, unless it is retried."""
        return self in {TaskState.SUCCEEDED, TaskState.FAILED, TaskState.SKIPPED, TaskState.CANCELLED}


class TaskKind(StrEnum):
    """What a task does with its frames."""

    RENDER = "render"
    MERGE = "merge"


class ExitClass(StrEnum):
    """How an attempt ended; the protocol says which are tried again."""

    SUCCEEDED = "succeeded"
    SCENE = "scene"
    CRASH = "crash"
    OUT_OF_MEMORY = "out_of_memory"
    TIMEOUT = "timeout"
    LOST = "lost"
    PREEMPTED = "preempted"
    OUTPUT = "output"
    CANCELLED = "cancelled"


class LimitUnit(StrEnum):
    """What a limit counts: running tasks, or hosts that run any."""

    TASK = "task"
    HOST = "host"


# --- what is to be done, as a submission is cut up ---


@dataclass(frozen=True, slots=True)
class LayerDependency:
    """A layer of the same job, by name."""

    layer: str
    frame_by_frame: bool = False


@dataclass(frozen=True, slots=True)
class TaskPlan:
    """One task to be. `needs`: indices, within the job's list of tasks, of those that have to be done before it."""

    layer: str
    kind: TaskKind
    frames: tuple[int, ...]
    sample_begin: int
    sample_end: int
    needs: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class LayerPlan:
    """One layer to be. `spec`: the serialized LayerSpec. `depends`: whole layers; by the frame is in tasks' `needs`."""

    name: str
    spec: bytes
    limits: tuple[str, ...] = ()
    depends: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class JobPlan:
    """A submission that was checked and cut up; `spec` is the serialized JobSpec. Task numbers are indices plus one."""

    title: str
    user: str
    spec: bytes
    priority: int
    retries: int
    layers: tuple[LayerPlan, ...]
    tasks: tuple[TaskPlan, ...]
    show: str = ""
    shot: str = ""
    tags: tuple[str, ...] = ()
    # Job numbers.
    depends: tuple[int, ...] = ()
    paused: bool = False
    request_id: str = ""
    # Digests of bundles that have to be kept while the job is.
    bundles: tuple[str, ...] = ()


# --- what is there ---


@dataclass(frozen=True, slots=True)
class TaskCounts:
    """Tasks of a job by state."""

    blocked: int = 0
    ready: int = 0
    running: int = 0
    succeeded: int = 0
    failed: int = 0
    skipped: int = 0
    cancelled: int = 0


@dataclass(frozen=True, slots=True)
class Job:
    """A job as it is. Times are [s since 1970, UTC]."""

    number: int
    title: str
    user: str
    spec: bytes
    state: JobState
    paused: bool
    priority: int
    retries: int
    show: str
    shot: str
    tags: tuple[str, ...]
    created: float
    started: float | None
    ended: float | None
    counts: TaskCounts
    frames_done: int
    frames_total: int
    render_seconds: float


@dataclass(frozen=True, slots=True)
class Attempt:
    """One try at a task. `exit_class` is None while it runs."""

    job: int
    task: int
    number: int
    worker: str
    host: str
    started: float
    ended: float | None = None
    exit_class: ExitClass | None = None
    message: str = ""
    prim_path: str = ""
    peak_memory_bytes: int = 0


@dataclass(frozen=True, slots=True)
class Task:
    """A task as it is. `attempt` is the number of the current or last attempt, 0 if there is none."""

    job: int
    number: int
    layer: str
    kind: TaskKind
    frames: tuple[int, ...]
    sample_begin: int
    sample_end: int
    state: TaskState
    frames_done: int
    failures: int
    attempt: int
    not_before: float
    last_attempt: Attempt | None = None


@dataclass(frozen=True, slots=True)
class Frame:
    """The image, or for a task with a sample range the part, of one frame. `stats`: serialized RenderStats."""

    job: int
    layer: str
    frame: int
    path: str
    sha256: str
    size_bytes: int
    task: int
    attempt: int
    stats: bytes = b""


@dataclass(frozen=True, slots=True)
class StagedFrame:
    """A frame whose file is about to be renamed from `temp_path` to its path, or just was."""

    attempt: Attempt
    frame: Frame
    temp_path: str


@dataclass(frozen=True, slots=True)
class Usage:
    """What a user has in the queue that has not ended."""

    jobs_open: int
    tasks_open: int


@dataclass(frozen=True, slots=True)
class Claim:
    """A task that was given to a worker, with what running it takes.

    `done`: frames of it that have an image already. `needs_from`: for a merge, the numbers of the tasks to be merged.
    """

    task: Task
    attempt: Attempt
    layer_spec: bytes
    job_spec: bytes
    user: str
    done: frozenset[int] = frozenset()
    needs_from: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Lane:
    """A place where one task runs at a time. `name` is `host/number`; block-lists are kept by it."""

    name: str
    host: str


@dataclass(frozen=True, slots=True)
class Ending:
    """How an attempt ended."""

    exit_class: ExitClass
    message: str = ""
    prim_path: str = ""
    peak_memory_bytes: int = 0


@dataclass(frozen=True, slots=True)
class Limit:
    """A named bound on what runs at the same time."""

    name: str
    most: int
    unit: LimitUnit
    running: int = 0


class EventKind(StrEnum):
    """What a recorded event is about."""

    JOB = "job"
    TASK = "task"
    FRAME = "frame"


@dataclass(frozen=True, slots=True)
class Event:
    """Something that was recorded. `task` and `frame` say which, where it is about one."""

    id: int
    time: float
    job: int
    kind: EventKind
    task: int | None = None
    layer: str = ""
    frame: int | None = None
    # The state it came into, for a job or task.
    state: str = ""


@dataclass(frozen=True, slots=True)
class Selection:
    """Tasks of a job; what is empty chooses all."""

    tasks: frozenset[int] = field(default_factory=frozenset)
    layer: str = ""
    frames: frozenset[int] | None = None
