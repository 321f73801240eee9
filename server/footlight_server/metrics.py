"""What Prometheus is told of a server. The only importer of prometheus_client."""

from collections.abc import Mapping
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, start_http_server

from footlight.v1 import stats_pb2

# [s] Most calls take milliseconds; streams take as long as a render.
_CALL_BUCKETS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100, 1000, 10_000)
_ATTEMPT_BUCKETS = (0.3, 1, 3, 10, 30, 100, 300, 1000, 3000, 10_000, 30_000)
# As RenderStats says.
_RAYS = ("closest", "shadow")
_LAG_BUCKETS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1, 3, 10)


class Metrics:
    """All of them, in a registry of their own. Rates are the reader's: `rate(footlight_rays_total[1m])`."""

    def __init__(self) -> None:
        self._registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        self._calls = Counter("footlight_calls", "Calls that have ended.", ["method", "code"], registry=registry)
        self._call_seconds = Histogram(
            "footlight_call_seconds", "How long calls took.", ["method"], buckets=_CALL_BUCKETS, registry=registry
        )
        self._attempts = Counter("footlight_attempts", "Attempts that have ended.", ["exit_class"], registry=registry)
        self._attempt_seconds = Histogram(
            "footlight_attempt_seconds", "How long they took.", buckets=_ATTEMPT_BUCKETS, registry=registry
        )
        self._frames = Counter("footlight_frames", "Images of jobs that were recorded.", registry=registry)
        self._rays = Counter("footlight_rays", "Rays of images and parts recorded.", ["kind"], registry=registry)
        self._samples = Counter("footlight_samples", "Camera samples of images and parts recorded.", registry=registry)
        self._tasks = Gauge("footlight_tasks", "Tasks of jobs in the queue, by state.", ["state"], registry=registry)
        self._lanes = Gauge("footlight_lanes", "Places where tasks can run.", registry=registry)
        self._lanes_busy = Gauge("footlight_lanes_busy", "Of them, with a task.", registry=registry)
        self._worker_processes = Gauge("footlight_worker_processes", "On this machine.", registry=registry)
        self._worker_memory = Gauge("footlight_worker_memory_bytes", "Resident, of all of them.", registry=registry)
        self._blobs = Gauge("footlight_blob_bytes", "Of uploads that are kept.", registry=registry)
        self._lag = Histogram(
            "footlight_loop_lag_seconds",
            "How late the event loop woke a task that slept.",
            buckets=_LAG_BUCKETS,
            registry=registry,
        )

    # --- what happens ---

    def count_call(self, method: str, code: str, seconds: float) -> None:
        """A call has ended."""
        self._calls.labels(method, code).inc()
        self._call_seconds.labels(method).observe(seconds)

    def count_attempt(self, exit_class: str, seconds: float) -> None:
        """An attempt at a task has ended."""
        self._attempts.labels(exit_class).inc()
        self._attempt_seconds.observe(seconds)

    def count_frame(self) -> None:
        """An image was recorded."""
        self._frames.inc()

    def count_work(self, stats: stats_pb2.RenderStats) -> None:
        """Samples were taken, for an image or a part of one; `stats` is what they cost."""
        self._samples.inc(stats.samples)
        for kind in _RAYS:  # what else is in there a worker made up
            self._rays.labels(kind).inc(stats.rays.get(kind, 0))

    def count_lag(self, seconds: float) -> None:
        """The event loop was that late."""
        self._lag.observe(seconds)

    # --- what is ---

    def show_tasks(self, counts: Mapping[str, int]) -> None:
        """Tasks by state."""
        for state, count in counts.items():
            self._tasks.labels(state).set(count)

    def show_lanes(self, lanes: int, busy: int) -> None:
        """Places where tasks can run, and those that have one."""
        self._lanes.set(lanes)
        self._lanes_busy.set(busy)

    def show_workers(self, processes: int, memory: int) -> None:
        """Processes below this one, and what they hold [bytes]."""
        self._worker_processes.set(processes)
        self._worker_memory.set(memory)

    def show_blobs(self, size: int) -> None:
        """[bytes] Of uploads."""
        self._blobs.set(size)

    def serve(self, host: str, port: int) -> WSGIServer:
        """Answer at http://host:port/metrics from a thread until it is shut down. Raises OSError."""
        server, _ = start_http_server(port, host, registry=self._registry)
        return server
