"""What the service costs: the time to the first tile, and rendering with and without a viewer."""

import time
from collections.abc import Iterator
from pathlib import Path

from footlight import Client, TileBatch, private_server, render_spec

# [pixels], [samples per pixel] Some seconds of rendering, enough to see 5 %.
SIZE = (512, 512)
SPP = 48


def first_tile_seconds(stage: Path, count: int) -> list[float]:
    """[s] From submitting to the first tile decoded, on one server with a warm worker; the first is not counted."""
    latencies = []
    with private_server() as address, Client(address) as client:
        for seed in range(count + 1):
            time.sleep(1.0)  # the server warms the next worker
            start = time.perf_counter()
            session = client.submit(render_spec(stage, camera="/World/Camera", size=SIZE, spp=4, seed=seed))
            seen = None
            for event in session.events():
                if seen is None and isinstance(event, TileBatch) and event.tiles:
                    seen = time.perf_counter() - start
            if seen is None:
                raise RuntimeError("a render ended without a tile")
            latencies.append(seen)
    return latencies[1:]


def streaming_pairs(stage: Path, count: int) -> Iterator[tuple[float, float]]:
    """[s] The time of rendering with a viewer that reads everything and without one, in turns."""
    with private_server() as address, Client(address) as client:

        def seconds(aovs: tuple[str, ...], seed: int) -> float:
            time.sleep(1.0)
            spec = render_spec(stage, camera="/World/Camera", size=SIZE, spp=SPP, seed=seed)
            session = client.submit(spec)
            for _ in session.events(aovs):
                pass
            return float(session.get().stats.seconds.render)

        seconds((), 0)
        for seed in range(count):
            yield seconds(("color",), seed), seconds((), seed)
