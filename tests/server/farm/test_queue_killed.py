"""kill -9 in the middle of transactions: what was said to be done is there, and nothing is there by half."""

import os
import random
import subprocess
import sys
import time
from pathlib import Path

from footlight_server.farm.model import JobState, Lane
from footlight_server.farm.queue import Queue
from tests.rules.sources import ROOT
from tests.server.farm.audit import audit
from tests.server.farm.jobs import Clock, run_all

ROUNDS = 5


def use_until_killed(url: str, notes: Path, seed: int, seconds: float) -> None:
    """One life of a process that uses the queue; it dies so many seconds after it has begun in earnest."""
    before = notes.read_text().count("ready") if notes.exists() else 0
    program = [sys.executable, str(Path(__file__).with_name("queue_user.py")), url, str(notes), str(seed)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(program, stderr=subprocess.PIPE, text=True, env=environment) as process:
        try:
            end = time.monotonic() + 60
            while not notes.exists() or notes.read_text().count("ready") == before:
                assert process.poll() is None, process.stderr and process.stderr.read()
                assert time.monotonic() < end
                time.sleep(0.01)
            time.sleep(seconds)
        finally:
            process.kill()
    assert process.returncode == -9


async def test_what_was_acknowledged_survives_kill_9_and_all_comes_to_an_end(database_url: str, tmp_path: Path) -> None:
    chance = random.Random(1)
    notes = tmp_path / "notes"
    for number in range(ROUNDS):
        use_until_killed(database_url, notes, number, 0.1 + chance.random() * 0.4)
        queue = await Queue.open(database_url)
        try:
            await audit(queue)
            await check(queue, notes)
        finally:
            await queue.close()
    assert notes.read_text().count("end") > 3 * ROUNDS
    await everything_ends(database_url)


async def check(queue: Queue, notes: Path) -> None:
    """What the process was told is so."""
    # The last line may be torn.
    for line in notes.read_text().splitlines(keepends=True):
        match line.split() if line.endswith("\n") else []:
            case ["job", job]:
                assert (await queue.job(int(job))).number == int(job)
            case ["frame", job, task]:
                assert len(await queue.parts(int(job), [int(task)])) == 1
            case ["end", job, task, number, how]:
                attempt = (await queue.attempts(int(job), int(task)))[int(number) - 1]
                assert attempt.exit_class == how
                if how == "succeeded":
                    assert (await queue.task(int(job), int(task))).state.value == "succeeded"


async def everything_ends(url: str) -> None:
    queue = await Queue.open(url, Clock(time.time() + 1000))
    try:
        await queue.recover()
        lane = Lane("fresh/1", "fresh")
        await run_all(queue, lane, (lane,))
        await audit(queue)
        assert {job.state for job in await queue.jobs(1000)} == {JobState.SUCCEEDED}
    finally:
        await queue.close()
