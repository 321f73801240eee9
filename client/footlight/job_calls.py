"""What calls about a job have in common, with threads and with asyncio: requests, and what answers mean."""

from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from typing import Any, Literal

from footlight.errors import JobCancelledError, JobFailedError, ProtocolError
from footlight.spec import by_name
from footlight.v1 import job_pb2, job_service_pb2

ImageFormat = Literal["exr", "thumbnail", "contact-sheet", "png"]

# [tasks, frames] The largest page there is.
PAGE = 1000

_FORMATS = {
    "exr": job_service_pb2.FRAME_FORMAT_EXR,
    "thumbnail": job_service_pb2.FRAME_FORMAT_THUMBNAIL,
    "contact-sheet": job_service_pb2.FRAME_FORMAT_CONTACT_SHEET,
    "png": job_service_pb2.FRAME_FORMAT_PNG,
}
_ENDED = {job_pb2.JOB_STATE_SUCCEEDED, job_pb2.JOB_STATE_FAILED, job_pb2.JOB_STATE_CANCELLED}


def job_state(word: str) -> job_pb2.JobState:
    """The state a word means: `running`. Raises ValueError."""
    state: job_pb2.JobState = _by_word(job_pb2.JobState, "JOB_STATE_", word)
    return state


def task_state(word: str) -> job_pb2.TaskState:
    """The state a word means: `failed`. Raises ValueError."""
    state: job_pb2.TaskState = _by_word(job_pb2.TaskState, "TASK_STATE_", word)
    return state


def words(enum: Any, prefix: str) -> list[str]:
    """The words for the values of an enum, without the unspecified one."""
    return [name.removeprefix(prefix).lower() for name, number in enum.items() if number != 0]


def _by_word(enum: Any, prefix: str, word: str) -> Any:
    name = f"{prefix}{word.upper()}"
    if name not in enum.keys() or enum.Value(name) == 0:  # noqa: SIM118 not a mapping
        raise ValueError(f"state: {word!r} is not one of {', '.join(words(enum, prefix))}")
    return enum.Value(name)


def get(name: str) -> job_service_pb2.GetJobRequest:
    """To ask for a job."""
    return job_service_pb2.GetJobRequest(name=name)


def tasks(name: str, states: Iterable[str], layer: str, count: int | None) -> job_service_pb2.ListTasksRequest:
    """To ask for the first page of tasks. Raises ValueError for an unknown state."""
    return job_service_pb2.ListTasksRequest(
        job=name,
        page_size=PAGE if count is None else min(max(count, 1), PAGE),
        states=[task_state(word) for word in states],
        layer=layer,
    )


def retry(name: str, tasks: Iterable[str], layer: str, frames: str) -> job_service_pb2.RetryTasksRequest:
    """To ask for another round."""
    return job_service_pb2.RetryTasksRequest(job=name, selection=_selection(tasks, layer, frames))


def skip(name: str, tasks: Iterable[str], layer: str, frames: str) -> job_service_pb2.SkipTasksRequest:
    """To give up on tasks."""
    return job_service_pb2.SkipTasksRequest(job=name, selection=_selection(tasks, layer, frames))


def _selection(tasks: Iterable[str], layer: str, frames: str) -> job_service_pb2.TaskSelection:
    return job_service_pb2.TaskSelection(tasks=tasks, layer=layer, frames=frames)


def frame(
    name: str, number: int, layer: str, image_format: ImageFormat, offset: int
) -> job_service_pb2.GetFrameRequest:
    """To ask for an image file from a byte on."""
    return job_service_pb2.GetFrameRequest(
        job=name, layer=layer, frame=number, format=by_name(_FORMATS, "image_format", image_format), offset=offset
    )


def pages(method: Callable[..., Any], request: Any, timeout: float) -> Iterator[Any]:
    """The answers of a listing, page by page."""
    while True:
        page = method(request, timeout=timeout)
        yield page
        if not page.next_page_token:
            return
        request.page_token = page.next_page_token


async def pages_async(method: Callable[..., Any], request: Any, timeout: float) -> AsyncIterator[Any]:  # noqa: ASYNC109 gRPC's
    """`pages` for asyncio."""
    while True:
        page = await method(request, timeout=timeout)
        yield page
        if not page.next_page_token:
            return
        request.page_token = page.next_page_token


def job(response: Any) -> job_pb2.Job:
    """The job of an answer."""
    found: job_pb2.Job = response.job
    return found


def changed(response: Any) -> int:
    """[tasks] That were changed."""
    number: int = response.changed
    return number


class Watch:
    """Where a job's watcher stands: the request that goes on from there, and the events that move it."""

    def __init__(self, name: str, after: int, *, only_new: bool) -> None:
        self._name = name
        self._after = after
        self._only_new = only_new

    def request(self) -> job_service_pb2.WatchJobRequest:
        """For the events that are not seen yet."""
        return job_service_pb2.WatchJobRequest(
            name=self._name, after=self._after, only_new=self._only_new and not self._after
        )

    def __call__(self, response: job_service_pb2.WatchJobResponse) -> job_pb2.JobEvent:
        """The event of an answer; the next request is for those after it."""
        event: job_pb2.JobEvent = response.event
        self._after = max(self._after, event.id)
        return event


class LogPosition:
    """Where a log's reader stands: the request that goes on from there, and the pieces that move it."""

    def __init__(self, name: str, offset: int, *, follow: bool) -> None:
        self._name = name
        self._offset = offset
        self._follow = follow

    def request(self) -> job_service_pb2.ReadLogRequest:
        """For what is not read yet."""
        return job_service_pb2.ReadLogRequest(name=self._name, offset=self._offset, follow=self._follow)

    def __call__(self, response: job_service_pb2.ReadLogResponse) -> bytes:
        """The text of an answer; the next request is for what follows it."""
        data: bytes = response.data
        self._offset = response.offset + len(data)
        return data


def has_ended(job: job_pb2.Job) -> bool:
    """The job is in one of the states that end."""
    return job.state in _ENDED


def has_failed(job: job_pb2.Job) -> bool:
    """The job is in the state FAILED."""
    return bool(job.state == job_pb2.JOB_STATE_FAILED)


def ended(name: str, job: job_pb2.Job | None) -> job_pb2.Job:
    """The last that was heard of a job. Raises ProtocolError if it has not ended by that."""
    if job is None or not has_ended(job):
        raise ProtocolError(f"the events of {name} ended before it did")
    return job


def outcome(job: job_pb2.Job, failed: tuple[job_pb2.Task, ...] = ()) -> job_pb2.Job:
    """`job` if it succeeded; raises JobFailedError with the tasks that failed, or JobCancelledError."""
    if has_failed(job):
        raise JobFailedError(job, failed)
    if job.state == job_pb2.JOB_STATE_CANCELLED:
        raise JobCancelledError(job)
    return job
