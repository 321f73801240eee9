"""What a viewer shows is what was sent, over real TCP; it keeps a few images, and may come and go."""

import asyncio
import time
from collections.abc import Callable

import numpy as np
import pytest

from footlight.image import LiveImage, Tile, TileBatch
from footlight.tev import KEPT, NoViewerError, TevViewer
from tests.client.tev_receiver import tev_receiver

WIDTH, HEIGHT, EDGE = 150, 100, 64


def batch(epoch: int, seed: int, aov: str = "color") -> TileBatch:
    """Random tiles that cover the image."""
    random = np.random.default_rng(seed)
    tiles = tuple(
        Tile(aov, x, y, 1, 4, random.random((min(EDGE, HEIGHT - y), min(EDGE, WIDTH - x), 3), np.float32) * 9)
        for y in range(0, HEIGHT, EDGE)
        for x in range(0, WIDTH, EDGE)
    )
    return TileBatch(epoch, 1, WIDTH, HEIGHT, tiles)


def wait_for(what: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_the_viewer_has_the_same_bits() -> None:
    sent, live = [batch(1, 1), batch(1, 2)], LiveImage()

    async def send(viewer: TevViewer) -> None:
        for one in sent:
            live.add(one)
            await viewer.show("12 main 1001", one)
        await viewer.show("12 main 1001", batch(1, 3, aov="depth"))  # not what is looked at
        await viewer.close()

    with tev_receiver() as receiver:
        asyncio.run(send(TevViewer("127.0.0.1", receiver.port)))
        wait_for(lambda: receiver.updates == 2 * len(sent[0].tiles))
    assert receiver.faults == []
    assert receiver.created == ["12 main 1001"]
    assert receiver.channels["12 main 1001"] == ["R", "G", "B"]
    assert receiver.images["12 main 1001"].tobytes() == live.pixels["color"].tobytes()


def test_a_new_epoch_begins_with_an_empty_image() -> None:
    half = batch(2, 4)
    half = TileBatch(2, 1, WIDTH, HEIGHT, half.tiles[:1])

    async def send(viewer: TevViewer) -> None:
        await viewer.show("a", batch(1, 1))
        await viewer.show("a", half)
        await viewer.close()

    with tev_receiver() as receiver:
        asyncio.run(send(TevViewer("127.0.0.1", receiver.port)))
        wait_for(lambda: receiver.updates == len(batch(1, 1).tiles) + 1)
    assert receiver.created == ["a", "a"]
    assert not receiver.images["a"][EDGE:].any()


def test_the_oldest_image_goes_when_there_are_too_many() -> None:
    async def send(viewer: TevViewer) -> None:
        for number in range(KEPT + 2):
            await viewer.show(str(number), batch(1, number))
        await viewer.close()

    with tev_receiver() as receiver:
        asyncio.run(send(TevViewer("127.0.0.1", receiver.port)))
        wait_for(lambda: receiver.updates == (KEPT + 2) * len(batch(1, 1).tiles))
    assert receiver.closed == ["0", "1"]


def test_a_viewer_may_come_late_and_come_again() -> None:
    async def send(viewer: TevViewer) -> None:
        await viewer.show("a", batch(1, 1))
        await viewer.close()

    with tev_receiver() as receiver:
        port = receiver.port
        viewer = TevViewer("127.0.0.1", port)
        asyncio.run(send(viewer))
        wait_for(lambda: receiver.updates > 0)
    with pytest.raises(NoViewerError, match=f"no viewer at 127.0.0.1:{port}: Conn"):
        asyncio.run(send(viewer))
    with tev_receiver() as receiver:
        viewer = TevViewer("127.0.0.1", receiver.port)
        asyncio.run(send(viewer))
        wait_for(lambda: receiver.updates > 0)


def test_a_viewer_that_does_not_read_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("footlight.tev.TIMEOUT", 0.3)

    async def send(port: int) -> None:
        viewer = TevViewer("127.0.0.1", port)
        said = ""
        for seed in range(10_000):
            try:
                await viewer.show("a", batch(1, seed))
            except NoViewerError as error:
                said = str(error)
                break
        assert said.endswith("it does not take anything in")

    async def main() -> None:
        async def never_read(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await done.wait()
            writer.transport.abort()

        done = asyncio.Event()
        server = await asyncio.start_server(never_read, "127.0.0.1", 0, limit=1)
        async with server:
            await send(server.sockets[0].getsockname()[1])
            done.set()
            await asyncio.sleep(0.1)

    started = time.monotonic()
    asyncio.run(main())
    assert time.monotonic() - started < 15


def test_without_tevclient_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("footlight.tev.find_spec", lambda _: None)
    with pytest.raises(NoViewerError, match=r"pip install 'footlight\[tev\]'"):
        TevViewer("localhost", 14158)
