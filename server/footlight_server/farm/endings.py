"""How the end of a frame's render counts for its attempt. Pure."""

from footlight.v1 import render_pb2
from footlight_server.farm.model import Ending, ExitClass
from footlight_server.workers.failure import Failure, FailureReason

# The protocol says which of them are tried again.
_CLASSES = {
    FailureReason.INVALID_ARGUMENT: ExitClass.SCENE,
    FailureReason.STAGE_UNREADABLE: ExitClass.SCENE,
    FailureReason.SCENE: ExitClass.SCENE,
    FailureReason.CRASHED: ExitClass.CRASH,
    FailureReason.INTERNAL: ExitClass.CRASH,
    FailureReason.OUT_OF_MEMORY: ExitClass.OUT_OF_MEMORY,
    FailureReason.TIMEOUT: ExitClass.TIMEOUT,
    FailureReason.OUTPUT: ExitClass.OUTPUT,
    FailureReason.LOST: ExitClass.LOST,
}
# What a worker that never had the task can die of, and the task is not at fault.
_NOT_ITS_FAULT = {ExitClass.CRASH, ExitClass.OUT_OF_MEMORY, ExitClass.TIMEOUT}


def ending_of(render: render_pb2.Render, failure: Failure | None, stop: Ending | None) -> Ending | None:
    """The attempt's ending for a render that has ended; None if there is a result to be recorded.

    `failure`: if it failed. `stop`: how the attempt was asked to end, if it was.
    """
    if render.state == render_pb2.RENDER_STATE_SUCCEEDED and render.has_result:
        return None
    if stop is not None:
        return stop
    if failure is None:  # counted, or it would be tried for ever
        return Ending(ExitClass.CRASH, "the worker ended without an image, and without a reason")
    exit_class = _CLASSES[failure.reason]
    if exit_class in _NOT_ITS_FAULT and not render.HasField("start_time"):
        return Ending(ExitClass.LOST, f"no worker could be had: {render.failure.message}")
    return Ending(exit_class, render.failure.message, failure.prim_path)
