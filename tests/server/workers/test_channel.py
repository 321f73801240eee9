"""Laws of the frames between server and worker."""

import asyncio
import os
import socket
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from footlight.worker.v1 import worker_pb2
from footlight_server.workers.channel import MAX_FRAME, BrokenFrameError, Frames, ServerEnd, WorkerEnd, frame


@given(st.lists(st.text(max_size=300), max_size=6), st.lists(st.integers(1, 50), min_size=1, max_size=20))
def test_messages_come_whole_however_the_bytes_are_cut(texts: list[str], cuts: list[int]) -> None:
    messages = [worker_pb2.Task(exr_path=text) for text in texts]
    stream = b"".join(frame(message) for message in messages)
    frames, received, at = Frames(), [], 0
    for i in range(len(stream)):
        size = cuts[i % len(cuts)]
        frames.feed(stream[at : at + size])
        at += size
        while (message := frames.take(worker_pb2.Task)) is not None:
            received.append(message)
    assert received == messages


@pytest.mark.parametrize(
    "data", [(MAX_FRAME + 1).to_bytes(4, "little"), b"\x03\x00\x00\x00\xff\xff\xff"], ids=["too long", "no protobuf"]
)
def test_what_is_no_frame_is_refused(data: bytes) -> None:
    frames = Frames()
    frames.feed(data)
    with pytest.raises(BrokenFrameError):
        frames.take(worker_pb2.Task)


async def test_a_descriptor_comes_with_its_message() -> None:
    ours, theirs = socket.socketpair()
    server = ServerEnd(ours, worker_pb2.WorkerEvent)
    worker = WorkerEnd(theirs)
    reading, writing = os.pipe()
    try:
        await asyncio.to_thread(worker.send, worker_pb2.WorkerEvent(film=worker_pb2.Film(width=3)), reading)
        async with asyncio.timeout(5):
            event = await server.receive()
        assert isinstance(event, worker_pb2.WorkerEvent)
        assert event.film.width == 3
        descriptor = server.take_descriptor()
        assert descriptor is not None
        os.write(writing, b"x")
        assert os.read(descriptor, 1) == b"x"
        assert not os.get_inheritable(descriptor)
        os.close(descriptor)
    finally:
        server.close()
        theirs.close()
        os.close(reading)
        os.close(writing)


async def test_the_end_of_the_worker_ends_the_messages() -> None:
    ours, theirs = socket.socketpair()
    server = ServerEnd(ours, worker_pb2.WorkerEvent)
    WorkerEnd(theirs).send(worker_pb2.WorkerEvent(writing=worker_pb2.Writing()))
    theirs.close()
    async with asyncio.timeout(5):
        assert await server.receive() is not None
        assert await server.receive() is None
    server.close()


async def test_a_worker_that_talks_without_end_neither_fills_memory_nor_takes_all_of_the_loop() -> None:
    ours, theirs = socket.socketpair()
    server = ServerEnd(ours, worker_pb2.WorkerEvent)
    theirs.setblocking(False)
    sent, empty = 0, bytes(4) * 4096
    for _ in range(1000):
        try:
            sent += theirs.send(empty)
        except BlockingIOError:
            await asyncio.sleep(0)
    assert sent < 4 << 20, "the rest waits with the worker"
    turns = 0

    async def others() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    other = asyncio.create_task(others())
    for _ in range(1000):
        assert await server.receive() is not None
    other.cancel()
    assert turns >= 999
    server.close()
    theirs.close()


async def test_a_worker_that_sends_descriptors_nobody_asked_for_is_let_go() -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    ours, theirs = socket.socketpair()
    server = ServerEnd(ours, worker_pb2.WorkerEvent)
    reading, writing = os.pipe()
    message = frame(worker_pb2.WorkerEvent(writing=worker_pb2.Writing()))
    for byte in message * 3:
        socket.send_fds(theirs, [bytes([byte])], [reading])
    async with asyncio.timeout(5):
        while await server.receive() is not None:
            assert len(list(Path("/proc/self/fd").iterdir())) < before + 10
    server.close()
    for descriptor in (reading, writing):
        os.close(descriptor)
    theirs.close()
    assert len(list(Path("/proc/self/fd").iterdir())) == before
