"""From the protocol's choice of tasks to the queue's."""

from footlight.v1 import job_service_pb2
from footlight_server.api.names import job_name, task_numbers
from footlight_server.farm.frames import FramesError, parse_frames
from footlight_server.farm.model import Selection
from footlight_server.sessions.errors import FieldViolation, InvalidFieldsError, TaskNotFoundError

_MOST_TASKS = 100_000


def parse_selection(asked: job_service_pb2.TaskSelection, job: int) -> Selection:
    """Tasks of that job. Raises InvalidFieldsError, TaskNotFoundError for a task of another job.

    A long range takes a second.
    """
    violations = []
    if len(asked.tasks) > _MOST_TASKS:
        violations.append(
            FieldViolation("selection.tasks", f"{len(asked.tasks)} tasks: at most {_MOST_TASKS} are allowed")
        )
    frames: tuple[int, ...] = ()
    try:
        frames = parse_frames(asked.frames)
    except FramesError as error:
        violations.append(FieldViolation("selection.frames", str(error)))
    if violations:
        raise InvalidFieldsError(violations)
    numbers = set()
    for name in asked.tasks:
        owner, number = task_numbers(name)
        if owner != job:
            raise TaskNotFoundError(f"{name} is not a task of {job_name(job)}")
        numbers.add(number)
    return Selection(tasks=frozenset(numbers), layer=asked.layer, frames=frozenset(frames) or None)
