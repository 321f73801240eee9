"""A lane that loses its workers is left alone for longer and longer, and a queue is not run through because of it."""

import math
from itertools import pairwise
from pathlib import Path

from footlight.worker.v1 import worker_pb2
from footlight_server.farm.local import LocalExecutor
from footlight_server.farm.model import ExitClass, JobState, Lane
from footlight_server.farm.rests import Rests
from footlight_server.workers.failure import Failure, FailureReason
from footlight_server.workers.pool import WorkerPool
from footlight_server.workers.process import WorkerGoneError, WorkerProcess
from tests.server.farm.farm import Place


def test_rests_double_up_to_a_minute_and_end_with_the_first_word() -> None:
    rests, now, lengths = Rests(), 100.0, []
    for _ in range(8):
        rests.note("a/1", ExitClass.LOST, now)
        lengths.append(rests.next_end(now) - now)
        assert not rests.over("a/1", now)
        assert rests.over("b/1", now)
        now = rests.next_end(now)
        assert rests.over("a/1", now)
    assert lengths == [1, 2, 4, 8, 16, 32, 60, 60]
    rests.note("a/1", ExitClass.LOST, now)
    rests.note("a/1", ExitClass.CRASH, now)
    assert rests.over("a/1", now)
    assert rests.next_end(now) == math.inf


def test_being_stopped_says_nothing_about_a_lane() -> None:
    rests = Rests()
    rests.note("a/1", ExitClass.LOST, 0.0)
    for how in (ExitClass.PREEMPTED, ExitClass.CANCELLED):
        rests.note("a/1", how, 0.0)
    assert rests.next_end(0.0) == 1.0


class Barren(LocalExecutor):
    """No worker can be had of it, so many times."""

    def __init__(self, times: int) -> None:
        super().__init__(1, 0)
        self.left = times

    def source(self, lane: Lane) -> WorkerPool:
        executor, pool = self, super().source(lane)

        class Source(WorkerPool):
            async def take(self, task: worker_pb2.Task) -> WorkerProcess:
                if executor.left:
                    executor.left -= 1
                    raise WorkerGoneError(Failure(FailureReason.CRASHED, "no worker starts here"))
                return await pool.take(task)

        return Source(0, spare=False)


async def test_a_machine_that_starts_no_worker_costs_a_few_attempts_and_no_task(tmp_path: Path) -> None:
    place = Place(tmp_path, lanes=1)
    async with place.farm(Barren(3)) as farm:
        job = await farm.submit(place.job(frames="1-20"))
        assert (await farm.end(job)).state is JobState.SUCCEEDED
        attempts = [attempt for number in range(1, 21) for attempt in await farm.attempts(job, number)]
        lost = [attempt for attempt in attempts if attempt.exit_class is ExitClass.LOST]
        assert len(lost) == 3, "and not one for each task that waits"
        assert "no worker starts here" in lost[0].message
        times = sorted(attempt.started for attempt in attempts)
        pauses = [later - earlier for earlier, later in pairwise(times[:4])]
        assert all(pause >= rest for pause, rest in zip(pauses, (1, 2, 4), strict=True))
