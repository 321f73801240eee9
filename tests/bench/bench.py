"""`make bench`: measures what the design promises, side by side in one run, and prints a table.

Usage: python tests/bench/bench.py [--quick] [FIGURE ...]
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from tests.bench import farm_queue, scenes, service, watchers  # noqa: E402

FOOTLIGHT = Path(sys.executable).with_name("footlight")
# What --stats writes, as far as it is read here: numbers by name, by group.
Stats = dict[str, dict[str, float]]
SMALL = ("--size", "512x512", "--spp", "16")


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table: what was measured, and what the design asks for."""

    figure: str
    value: str
    aim: str = ""
    met: bool | None = None


@dataclass(frozen=True, slots=True)
class Bench:
    """Where stages and images go, and how much of everything."""

    folder: Path
    quick: bool

    def rounds(self) -> int:
        """How often a pair is measured; the median counts."""
        return 1 if self.quick else 3

    def room(self, triangles: int) -> Path:
        """The stage of a room with that many triangles, written once."""
        stage = self.folder / f"room{triangles}.usdc"
        if not stage.exists():
            scenes.write_room(stage, triangles)
        return stage

    def render(self, stage: Path, *options: str, environment: dict[str, str] | None = None) -> Stats:
        """Render through a private service; answers the statistics."""
        stats = self.folder / "stats.json"
        command = (FOOTLIGHT, "render", stage, "-o", self.folder / "out.exr", "--camera", "/World/Camera")
        subprocess.run(
            [str(part) for part in (*command, "--stats", stats, *options)],
            check=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **(environment or {})},
        )
        loaded: Stats = json.loads(stats.read_text())
        return loaded


def threads(bench: Bench) -> Iterator[Row]:
    """Two threads against one, on a scene in cache and on one out of it."""
    for triangles in (5_000, 1_000_000):
        stage = bench.room(triangles)
        ratios = []
        for _ in range(bench.rounds()):
            one, two = (bench.render(stage, *SMALL, "--threads", count)["seconds"]["render"] for count in ("1", "2"))
            ratios.append(one / two)
        ratio = statistics.median(ratios)
        yield Row(f"two threads against one, {triangles} triangles", f"{ratio:.2f} x", ">= 1.9 x", ratio >= 1.9)


def embree(bench: Bench) -> Iterator[Row]:
    """How much of the CPU time of a render is traversal, and how many rays that is."""
    for triangles in (5_000, 1_000_000):
        stage = bench.room(triangles)
        stats = bench.render(stage, *SMALL)
        total = sum(stats["cpu_seconds"].values())
        rays = sum(stats["rays"].values())
        yield Row(f"rays per CPU second, {triangles} triangles", f"{rays / total / 1e6:.1f} M")
        share = number(stats, "embree_cpu_seconds") / total
        yield Row(f"CPU time inside Embree, {triangles} triangles", f"{share:.0%}")


def instruction_sets(bench: Bench) -> Iterator[Row]:
    """The same room on every instruction set: batches and packets of 4, 8 and 16 lanes, one thread."""
    stage = bench.room(5_000)
    rates: dict[str, float] = {}
    for level in ("v2", "v3", "v4"):
        try:
            stats = bench.render(stage, *SMALL, "--threads", "1", environment={"FOOTLIGHT_INSTRUCTION_SET": level})
        except subprocess.CalledProcessError:
            yield Row(f"samples per second on x86-64-{level}, one thread", "not on this machine")
            continue
        rates[level] = number(stats, "samples") / stats["seconds"]["render"]
        ratio = rates[level] / next(iter(rates.values()))
        yield Row(f"samples per second on x86-64-{level}, one thread", f"{rates[level] / 1e6:.2f} M, {ratio:.2f} x")


def flat(bench: Bench) -> Iterator[Row]:
    """Five million triangles in one mesh: memory, and how fast points are translated."""
    stage = bench.folder / "flat.usdc"
    grid = scenes.write_flat(stage, 500_000 if bench.quick else 5_000_000)
    small = bench.folder / "small.usdc"
    scenes.write_flat(small, 1_000)
    options = ("--size", "256x256", "--spp", "4")
    base, stats = bench.render(small, *options), bench.render(stage, *options)
    grown = number(stats, "peak_memory_bytes") - number(base, "peak_memory_bytes")
    per_triangle = grown / grid.triangles
    yield Row(
        f"peak memory, {grid.triangles} flat triangles", f"{per_triangle:.0f} B each", "<= 250", per_triangle <= 250
    )
    rate = len(grid.points) / stats["seconds"]["translate"]
    yield Row("points translated per second", f"{rate / 1e6:.1f} M", ">= 1 M", rate >= 1e6)
    yield Row("seconds to open, translate, commit", seconds(stats))


def instanced(bench: Bench) -> Iterator[Row]:
    """Ten million triangles by a PointInstancer."""
    stage = bench.folder / "instanced.usdc"
    triangles = scenes.write_instanced(stage, 10_000_000, 1_000)
    stats = bench.render(stage, "--size", "256x256", "--spp", "4")
    peak = number(stats, "peak_memory_bytes") / 1e6
    yield Row(f"peak memory, {triangles} instanced triangles", f"{peak:.0f} MB")
    yield Row("seconds to open, translate, commit", seconds(stats))


def number(stats: Stats, name: str) -> float:
    """A figure that stands alone."""
    return float(stats[name])  # type: ignore[arg-type]


def seconds(stats: Stats) -> str:
    """The parts of a render before its first sample."""
    return ", ".join(f"{stats['seconds'][part]:.2f}" for part in ("open", "translate", "commit"))


def first_tile(bench: Bench) -> Iterator[Row]:
    """From the request to the first tile on a running server with a warm worker."""
    stage = bench.room(5_000)
    latencies = service.first_tile_seconds(stage, 3 if bench.quick else 9)
    middle = statistics.median(latencies)
    yield Row("first tile after the request", f"{middle:.3f} s (worst {max(latencies):.3f})", "<= 0.3 s", middle <= 0.3)


def streaming(bench: Bench) -> Iterator[Row]:
    """What streaming tiles adds to the time of rendering, pairs in turns."""
    stage = bench.room(5_000)
    costs = [on / off - 1 for on, off in service.streaming_pairs(stage, 2 if bench.quick else 5)]
    cost = statistics.median(costs)
    yield Row("cost of streaming", f"{cost:+.1%} of render time", "< 5 %", cost < 0.05)


def watching(bench: Bench) -> Iterator[Row]:
    """A hundred who watch a job, two of whom never read."""
    rounds = list(watchers.rounds(bench.room(5_000), 1 if bench.quick else 3, 98, 2))
    cost = statistics.median(r.readers.render_seconds / r.alone.render_seconds - 1 for r in rounds)
    yield Row("cost of 98 watchers, on the same cores", f"{cost:+.1%} of render time")
    cost = statistics.median(r.silent.render_seconds / r.readers.render_seconds - 1 for r in rounds)
    yield Row("cost of 2 more who never read", f"{cost:+.1%} of render time", "< 5 %", cost < 0.05)
    seen = [r.silent.seen for r in rounds if r.silent.seen is not None]
    ended = min(some.ended for some in seen)
    yield Row("of the 98, saw the job to its end", str(ended), "98", ended == 98)
    delay = watchers.percentile([delay for some in seen for delay in some.delays], 0.99)
    yield Row("delay of their events, 99th percentile", f"{delay:.2f} s", "< 1 s", delay < 1)
    grown = max(r.silent.grown for r in rounds) / 1e6
    yield Row("memory the server grew by", f"{grown:.0f} MB", "< 64 MB", grown < 64)


def queue(bench: Bench) -> Iterator[Row]:
    """A job of ten thousand tasks in the farm's queue."""
    measured = []
    for turn in range(bench.rounds()):
        folder = bench.folder / f"queue{turn}"
        folder.mkdir()
        measured.append(farm_queue.measure(folder, 512 if bench.quick else 2048))

    def middle(name: str) -> float:
        return float(statistics.median(getattr(each, name) for each in measured))

    submit, page = middle("submit"), middle("slowest_page")
    yield Row("10000 tasks put into the queue", f"{submit:.2f} s", "< 1 s", submit < 1)
    for name, figure in (
        ("claims_in_batches", "tasks claimed by 32 lanes, in one call"),
        ("claims_one_by_one", "by 32 calls"),
    ):
        yield Row(figure, f"{middle(name):.0f} per second", "> 500", middle(name) > 500)
    yield Row("tasks ended by 32 calls", f"{middle('endings'):.0f} per second")
    yield Row("slowest page of 1000 tasks", f"{page * 1000:.0f} ms", "< 50 ms", page < 0.05)
    yield Row("10000 tasks cancelled", f"{middle('cancel'):.2f} s")


FIGURES: dict[str, Callable[[Bench], Iterator[Row]]] = {
    "threads": threads,
    "embree": embree,
    "instruction_sets": instruction_sets,
    "first_tile": first_tile,
    "streaming": streaming,
    "watching": watching,
    "queue": queue,
    "flat": flat,
    "instanced": instanced,
}


def main() -> None:
    """Measure the figures named, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("figures", nargs="*", metavar="FIGURE", help=", ".join(FIGURES))
    parser.add_argument("--quick", action="store_true", help="fewer rounds, a tenth of the triangles")
    arguments = parser.parse_args()
    unknown = set(arguments.figures) - set(FIGURES)
    if unknown:
        parser.error(f"no figure {', '.join(sorted(unknown))}; there are {', '.join(FIGURES)}")
    load = os.getloadavg()[0]
    if load > 0.5:
        print(f"This machine is busy (load {load:.1f}): what is measured by the clock says little.")
    print(f"{'figure':52} {'measured':32} {'aim':10}")
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), arguments.quick)
        for name in arguments.figures or FIGURES:
            for row in FIGURES[name](bench):
                mark = {None: "", True: "met", False: "missed"}[row.met]
                print(f"{row.figure:52} {row.value:32} {row.aim:10} {mark}", flush=True)


if __name__ == "__main__":
    main()
