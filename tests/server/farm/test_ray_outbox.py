"""What a slow server misses between a worker on a node and itself: nothing but old tiles and old progress."""

import asyncio

from footlight.v1 import render_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.farm.ray.outbox import MOST_TILES, Entry, Outbox, PendingTiles


def tiles(aov: str, indices: list[int], samples: int) -> worker_pb2.WorkerEvent:
    return worker_pb2.WorkerEvent(tiles=worker_pb2.Tiles(aov=aov, indices=indices, samples=samples, scale=1))


def progress(done: float) -> worker_pb2.WorkerEvent:
    return worker_pb2.WorkerEvent(progress=render_pb2.Progress(samples_done=done))


def drain(*events: worker_pb2.WorkerEvent) -> list[Entry]:
    async def run() -> list[Entry]:
        outbox = Outbox()
        for event in events:
            outbox.put(event)
        entries: list[Entry] = []
        while True:
            try:
                async with asyncio.timeout(0.01):
                    entries.append(await outbox.next())
            except TimeoutError:
                return entries

    return asyncio.run(run())


def test_tiles_are_merged_and_the_newest_version_of_each_counts() -> None:
    (entry,) = drain(tiles("color", [0, 1, 2], 1), tiles("color", [1], 4), tiles("color", [2], 4))
    assert isinstance(entry, PendingTiles)
    assert {(tuple(m.indices), m.samples) for m in entry.messages()} == {((0,), 1), ((1, 2), 4)}


def test_progress_is_the_newest_and_everything_else_keeps_its_order() -> None:
    opened = worker_pb2.WorkerEvent(opened=worker_pb2.Opened())
    writing = worker_pb2.WorkerEvent(writing=worker_pb2.Writing())
    entries = drain(opened, progress(1), tiles("color", [0], 1), progress(2), tiles("depth", [0], 1), writing)
    kinds = [entry.aov if isinstance(entry, PendingTiles) else entry.WhichOneof("event") for entry in entries]
    assert kinds == ["opened", "color", "progress", "depth", "writing"]
    assert isinstance(entries[2], worker_pb2.WorkerEvent)
    assert entries[2].progress.samples_done == 2


def test_tiles_come_before_the_end_that_was_said_after_them() -> None:
    done = worker_pb2.WorkerEvent(done=worker_pb2.Done())
    first, second = drain(tiles("color", [3], 8), done)
    assert isinstance(first, PendingTiles)
    assert isinstance(second, worker_pb2.WorkerEvent)
    assert second.HasField("done")


def test_what_waits_does_not_grow_with_time() -> None:
    events = [event for sample in range(1000) for event in (tiles("color", [sample % 7], sample), progress(sample))]
    assert len(drain(*events)) == 2


def test_a_large_image_is_sent_in_pieces() -> None:
    (entry,) = drain(tiles("color", list(range(3 * MOST_TILES + 1)), 1))
    assert isinstance(entry, PendingTiles)
    messages = entry.messages()
    assert [len(message.indices) for message in messages] == [MOST_TILES] * 3 + [1]
    assert [index for message in messages for index in message.indices] == list(range(3 * MOST_TILES + 1))
