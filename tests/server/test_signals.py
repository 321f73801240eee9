"""Waiting for work, unless something happens first; and ending parts one after the other."""

import asyncio
import logging

import pytest

from footlight_server.closing import closing
from footlight_server.signals import unless


async def test_work_that_ends_first_has_ended() -> None:
    assert await unless(asyncio.Event(), asyncio.sleep(0))


async def test_work_is_given_up_when_it_happens() -> None:
    event, ended = asyncio.Event(), []

    async def work() -> None:
        try:
            await asyncio.sleep(60)
        finally:
            ended.append("cleaned up")

    asyncio.get_running_loop().call_later(0.05, event.set)
    async with asyncio.timeout(5):
        assert not await unless(event, work())
    assert ended == ["cleaned up"]


async def test_what_work_raises_is_raised() -> None:
    async def work() -> None:
        raise RuntimeError("no cluster")

    with pytest.raises(RuntimeError, match="no cluster"):
        await unless(asyncio.Event(), work())


async def test_whoever_waits_is_cancelled_with_the_work() -> None:
    working = asyncio.Event()
    ended = asyncio.Event()

    async def work() -> None:
        working.set()
        try:
            await asyncio.sleep(60)
        finally:
            ended.set()

    waiting = asyncio.create_task(unless(asyncio.Event(), work()))
    await working.wait()
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
    assert ended.is_set()


async def test_a_part_that_hangs_or_fails_does_not_keep_the_next_from_its_end(caplog: pytest.LogCaptureFixture) -> None:
    async def fail() -> None:
        raise OSError("no disk")

    async def hang() -> None:
        await asyncio.sleep(60)

    with caplog.at_level(logging.ERROR):
        async with asyncio.timeout(5):
            await closing("one", fail, 1)
            await closing("two", hang, 0.05)
    assert [record.getMessage() for record in caplog.records] == [
        "one did not end well",
        "two did not end within 0.05 s",
    ]
