"""The stage's path as whoever asked for it knows it: that of an uploaded one counts from its bundle."""

from footlight.v1 import render_pb2
from footlight.worker.v1 import worker_pb2


def shown_stage(task: worker_pb2.Task, spec: render_pb2.RenderSpec) -> str:
    """`spec`: of the task, or what came of it. Where the server lays bundles out concerns nobody."""
    if spec.bundle and task.roots:
        return str(spec.stage_path).removeprefix(f"{task.roots[0]}/")
    return str(spec.stage_path)


def shown_message(task: worker_pb2.Task, message: str) -> str:
    """A sentence about a task's stage, with paths as above."""
    if task.spec.bundle and task.roots:
        return message.replace(f"{task.roots[0]}/", "")
    return message
