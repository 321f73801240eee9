"""The process between the server and a Ray cluster: `python -m footlight_server.farm.ray.bridge FD ADDRESS`.

A process of its own because Ray ends the process that uses it when the cluster's head is gone for a minute (measured
with 2.60), and because it brings its threads, signal handlers and 300 MB along. If it ends, the server starts another.
"""

import asyncio
import contextlib
import logging
import socket
import sys
from collections.abc import Sequence
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from footlight.v1 import render_pb2
from footlight.worker.v1 import bridge_pb2
from footlight_server.farm.ray.environment import LANE_RESOURCE
from footlight_server.farm.ray.lane_actor import LaneActor
from footlight_server.workers.channel import ServerEnd
from footlight_server.workers.limits import die_with_parent

log = logging.getLogger("footlight_server.farm.ray.bridge")

# [s] Between looks at the cluster.
_LOOK = 2.0
# [s] For one call to an actor that answers at once.
_CALL = 10.0


class Bridge:
    """Relays between one socket and the actors of the lanes, one actor a lane, started when it is first needed."""

    def __init__(self, channel: ServerEnd) -> None:
        self._channel = channel
        # Sends are whole messages in order.
        self._sending = asyncio.Lock()
        # lane -> the node it is on.
        self._nodes: dict[str, str] = {}
        self._actors: dict[str, Any] = {}
        # call -> lane.
        self._calls: dict[int, str] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """Until the server closes its end."""
        self._start(self._watch_lanes())
        while (request := await self._channel.receive()) is not None:
            assert isinstance(request, bridge_pb2.BridgeRequest)
            match request.WhichOneof("request"):
                case "take":
                    self._start(self._converse(request.call, request.take))
                case "send":
                    self._tell(request.call, "send", request.send.SerializeToString())
                case "kill":
                    self._tell(request.call, "kill")
                case "end":
                    self._tell(request.call, "end")

    def _start(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _send(self, event: bridge_pb2.BridgeEvent) -> None:
        async with self._sending:
            await self._channel.send(event)

    async def _watch_lanes(self) -> None:
        while True:
            nodes = await asyncio.to_thread(ray.nodes)
            self._nodes = {
                f"{node['NodeName']}/{number}": node["NodeID"]
                for node in nodes
                if node["Alive"]
                for number in range(1, int(node["Resources"].get(LANE_RESOURCE, 0)) + 1)
            }
            for lane in set(self._actors) - set(self._nodes):
                del self._actors[lane]
            lanes = bridge_pb2.Lanes()
            for lane in sorted(self._nodes):
                lanes.lanes.add(name=lane, node=lane.rpartition("/")[0])
            await self._send(bridge_pb2.BridgeEvent(lanes=lanes))
            await asyncio.sleep(_LOOK)

    def _actor(self, lane: str, memory_limit: int) -> Any:
        if lane not in self._actors:
            actor: Any = ray.remote(LaneActor)
            self._actors[lane] = actor.options(
                # Ray retries nothing: the queue does, and knows why.
                max_restarts=0,
                max_task_retries=0,
                max_concurrency=16,
                num_cpus=0,
                resources={LANE_RESOURCE: 1},
                scheduling_strategy=NodeAffinitySchedulingStrategy(self._nodes[lane], soft=False),
            ).remote(memory_limit)
        return self._actors[lane]

    async def _converse(self, call: int, take: bridge_pb2.Take) -> None:
        """Relay all that a lane says in one conversation. Its end is `gone`, whatever happens."""
        if take.lane not in self._nodes:
            await self._send(_lost(call, f"{take.lane} is not in the cluster any more"))
            return
        self._calls[call] = take.lane
        try:
            actor = self._actor(take.lane, take.memory_limit)
            stream = actor.converse.options(num_returns="streaming").remote(take.task.SerializeToString())
            ended = False
            async for reference in stream:
                event = bridge_pb2.BridgeEvent.FromString(await reference)
                event.call = call
                ended = event.HasField("gone")
                await self._send(event)
            if not ended:
                await self._send(bridge_pb2.BridgeEvent(call=call, gone=bridge_pb2.Gone()))
        except ray.exceptions.RayError as error:
            self._actors.pop(take.lane, None)
            what = type(error).__name__
            log.warning("lane %s: %s: %s", take.lane, what, str(error)[:500])
            lost = _lost(call, f"the process that holds {take.lane} is gone ({what})")
            lost.gone.unreachable = isinstance(error, ray.exceptions.ActorUnavailableError)
            await self._send(lost)
        finally:
            del self._calls[call]

    def _tell(self, call: int, method: str, *arguments: bytes) -> None:
        actor = self._actors.get(self._calls.get(call, ""))
        if actor is not None:
            self._start(_call(getattr(actor, method), *arguments))


async def _call(method: Any, *arguments: bytes) -> None:
    """A call whose failure shows in the conversation."""
    with contextlib.suppress(ray.exceptions.RayError, TimeoutError):
        async with asyncio.timeout(_CALL):
            await method.remote(*arguments)


def _lost(call: int, message: str) -> bridge_pb2.BridgeEvent:
    failure = render_pb2.Failure(reason=render_pb2.FAILURE_REASON_LOST, message=message)
    return bridge_pb2.BridgeEvent(call=call, gone=bridge_pb2.Gone(failure=failure))


async def _serve(descriptor: int) -> None:
    channel = ServerEnd(socket.socket(fileno=descriptor), bridge_pb2.BridgeRequest)
    try:
        await Bridge(channel).run()
    finally:
        channel.close()


def main(arguments: Sequence[str]) -> None:
    """Join the cluster at ADDRESS and relay over the socket FD until the server goes."""
    die_with_parent()
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    descriptor, address = int(arguments[0]), arguments[1]
    ray.init(address=address, namespace="footlight", log_to_driver=False, logging_level=logging.WARNING)
    asyncio.run(_serve(descriptor))


if __name__ == "__main__":
    main(sys.argv[1:])
