"""The lanes of a cluster come back, whatever the bridge to it died of; and what one of them says harms no other."""

import asyncio
from pathlib import Path
from typing import Self

import pytest

from footlight.v1 import render_pb2
from footlight.worker.v1 import bridge_pb2, worker_pb2
from footlight_server.farm.ray.environment import Access
from footlight_server.farm.ray.executor import RayExecutor
from footlight_server.farm.ray.link import Lanes
from footlight_server.farm.ray.worker import RayWorker
from footlight_server.workers.failure import FailureReason
from footlight_server.workers.process import WorkerGoneError


class Bridge:
    """Cannot be started, fails in the middle, then is there."""

    tries = 0

    def __init__(self, lanes: Lanes) -> None:
        self._lanes = lanes

    @classmethod
    async def start(cls, address: str, access: Access, lanes: Lanes) -> Self:
        del address, access
        cls.tries += 1
        if cls.tries == 1:
            raise OSError("Cannot allocate memory")
        return cls(lanes)

    async def run(self, patience: float) -> None:
        del patience
        self._lanes.update(bridge_pb2.Lanes(lanes=[{"name": f"n/{self.tries}", "node": "n"}]))
        if self.tries == 2:
            raise KeyError("what the bridge said")
        await asyncio.Event().wait()

    async def close(self) -> None: ...


async def test_a_bridge_that_fails_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("footlight_server.farm.ray.executor.BridgeLink", Bridge)
    monkeypatch.setattr("footlight_server.farm.ray.executor._PAUSE", 0.01)
    token = tmp_path / "token"
    token.write_text("t" * 64)
    token.chmod(0o600)
    executor = RayExecutor("127.0.0.1:1", Access(token), 0)
    await executor.start()
    async with asyncio.timeout(5):
        while [lane.name for lane in executor.lanes()] != ["n/3"]:
            await asyncio.sleep(0.01)
    await executor.close()


class Sent:
    """A link that keeps what is sent."""

    def __init__(self) -> None:
        self.requests: list[bridge_pb2.BridgeRequest] = []

    def open(self, listener: object) -> int:
        del listener
        return 1

    def forget(self, call: int) -> None: ...

    async def send(self, request: bridge_pb2.BridgeRequest) -> None:
        self.requests.append(request)


@pytest.mark.parametrize(
    "tiles",
    [
        worker_pb2.Tiles(aov="unknown", indices=[0], samples=1, scale=1),
        worker_pb2.Tiles(aov="color", indices=[0], samples=1, scale=1),
        worker_pb2.Tiles(aov="color", indices=[0, 1 << 30], samples=1, scale=1),
    ],
)
async def test_tiles_that_are_none_end_their_worker_and_no_other(
    tiles: worker_pb2.Tiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stage that is not trusted may have sent them; raised where all lanes are heard, they would end all of them."""
    monkeypatch.setattr("footlight_server.farm.ray.worker._ENDING", 0.01)
    link = Sent()
    worker = RayWorker(link, "n/1", print)  # type: ignore[arg-type]
    film = worker_pb2.Film(width=4, height=4, aovs=[{"name": "color", "channels": 3}])
    worker.open_film(film)
    said = bridge_pb2.Said(event=worker_pb2.WorkerEvent(tiles=tiles), pixels=[b"x"])
    worker.hear(bridge_pb2.BridgeEvent(said=said))
    with pytest.raises(WorkerGoneError, match="no tile") as caught:
        await worker.receive()
    assert caught.value.failure.reason is FailureReason.INTERNAL
    await worker.close()
    assert link.requests[-1].HasField("end")


@pytest.mark.parametrize(("unreachable", "suspected"), [(True, ["n/1"]), (False, [])])
async def test_a_lane_that_cannot_be_reached_is_left_alone_and_one_whose_process_died_is_not(
    *, unreachable: bool, suspected: list[str]
) -> None:
    told: list[str] = []
    worker = RayWorker(Sent(), "n/1", told.append)  # type: ignore[arg-type]
    failure = render_pb2.Failure(reason=render_pb2.FAILURE_REASON_LOST, message="gone")
    worker.hear(bridge_pb2.BridgeEvent(gone=bridge_pb2.Gone(failure=failure, unreachable=unreachable)))
    with pytest.raises(WorkerGoneError):
        await worker.receive()
    assert told == suspected
