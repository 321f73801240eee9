"""The worker process: loads USD and the core, waits for one task, does it, ends. Started by WorkerProcess."""

import faulthandler
import os
import socket
import sys

from footlight_server.workers.limits import die_with_parent


def main() -> None:
    """Serve the connection whose descriptor is the only argument."""
    die_with_parent()
    faulthandler.enable()
    # The slow imports come after the kernel knows whom this process belongs to.
    from footlight.worker.v1 import worker_pb2  # noqa: PLC0415
    from footlight_server.workers.causes import failure_of  # noqa: PLC0415
    from footlight_server.workers.confine import confine  # noqa: PLC0415
    from footlight_server.workers.limits import set_limits  # noqa: PLC0415
    from footlight_server.workers.link import Link  # noqa: PLC0415

    link = Link(socket.socket(fileno=int(sys.argv[1])))
    try:
        from footlight_server.workers.merge_task import MergeTask  # noqa: PLC0415
        from footlight_server.workers.render_task import RenderTask  # noqa: PLC0415
        from footlight_server.workers.sheet_task import SheetTask  # noqa: PLC0415
        from footlight_server.workers.versions import versions  # noqa: PLC0415

        link.send(worker_pb2.WorkerEvent(ready=worker_pb2.Ready(versions=versions())))
        task = link.receive_task()
        set_limits(task.memory_bytes, task.open_cpu_seconds)
        if task.HasField("confinement"):
            confine(task.confinement)
        # From here on there are more threads: all that one may do was settled before.
        link.listen()
        kind = SheetTask if task.sheet_paths else MergeTask if task.merge_paths else RenderTask
        kind(task, link).run()
    except BrokenPipeError:
        pass  # the server has gone, and with it whoever would want to know
    except Exception as error:  # noqa: BLE001 - the boundary: whatever happened becomes a failure with a reason
        link.send_failure(failure_of(error))
        faulthandler.disable()
    # Threads of USD and the core need no farewell; taking a large scene apart would only cost time.
    sys.stderr.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
