"""A process that uses a queue until it is killed: submits, claims, commits, finishes; notes what it was told is done.

Usage: python queue_user.py URL NOTES SEED
"""

import asyncio
import os
import random
import sys

from footlight_server.farm.model import Ending, ExitClass, Lane
from footlight_server.farm.queue import Queue
from tests.server.farm.jobs import a_job, frame_of

LANES = tuple(Lane(f"h/{number}", "h") for number in range(4))


async def use(url: str, notes: int, chance: random.Random) -> None:
    def note(*words: object) -> None:
        """Reaches the file at once, whatever happens next."""
        os.write(notes, (" ".join(map(str, words)) + "\n").encode())

    queue = await Queue.open(url)
    for staged in await queue.staged():
        if not await queue.commit_frame(staged.attempt, staged.frame):
            await queue.unstage(staged)
    await queue.recover()
    note("ready")
    while True:
        if (await queue.usage("ada")).tasks_open < 8:
            job = await queue.create_job(a_job(frames=chance.randint(1, 10), retries=100))
            note("job", job.number)
        for claimed in await queue.claim_many(LANES, LANES):
            attempt = claimed.attempt
            await queue.stage_frame(attempt, frame_of(claimed), "/tmp/x")
            if chance.random() < 0.8:
                await queue.commit_frame(attempt, frame_of(claimed))
                note("frame", attempt.job, attempt.task)
            how = chance.choice([ExitClass.SUCCEEDED, ExitClass.SUCCEEDED, ExitClass.TIMEOUT, ExitClass.PREEMPTED])
            await queue.finish(attempt, Ending(how))
            note("end", attempt.job, attempt.task, attempt.number, how.value)


if __name__ == "__main__":
    file = os.open(sys.argv[2], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    asyncio.run(use(sys.argv[1], file, random.Random(int(sys.argv[3]))))
