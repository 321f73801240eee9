"""`make bench`: measures what the design promises, side by side in one run, and prints a table.

Usage: python tests/bench/bench.py [--quick] [FIGURE ...]
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from tests.bench import scenes, service  # noqa: E402

FOOTLIGHT = Path(sys.executable).with_name("footlight")


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

    def render(self, stage: Path, *options: str) -> dict[str, dict[str, float]]:
        """Render through a private service; answers the statistics."""
        stats = self.folder / "stats.json"
        command = (FOOTLIGHT, "render", stage, "-o", self.folder / "out.exr", "--camera", "/World/Camera")
        subprocess.run(
            [str(part) for part in (*command, "--stats", stats, *options)], check=True, stdout=subprocess.DEVNULL
        )
        loaded: dict[str, dict[str, float]] = json.loads(stats.read_text())
        return loaded


def threads(bench: Bench) -> Iterator[Row]:
    """Two threads against one, on a scene in cache and on one out of it."""
    for triangles in (5_000, 1_000_000):
        stage = bench.folder / f"room{triangles}.usdc"
        scenes.write_room(stage, triangles)
        ratios = []
        for _ in range(bench.rounds()):
            one, two = (
                bench.render(stage, "--size", "512x512", "--spp", "16", "--threads", count)["seconds"]["render"]
                for count in ("1", "2")
            )
            ratios.append(one / two)
        ratio = statistics.median(ratios)
        yield Row(f"two threads against one, {triangles} triangles", f"{ratio:.2f} x", ">= 1.9 x", ratio >= 1.9)


def embree(bench: Bench) -> Iterator[Row]:
    """How much of the CPU time of a render is traversal, and how many rays that is."""
    for triangles in (5_000, 1_000_000):
        stage = bench.folder / f"room{triangles}.usdc"
        if not stage.exists():
            scenes.write_room(stage, triangles)
        stats = bench.render(stage, "--size", "512x512", "--spp", "16")
        total = sum(stats["cpu_seconds"].values())
        rays = sum(stats["rays"].values())
        yield Row(f"rays per CPU second, {triangles} triangles", f"{rays / total / 1e6:.1f} M")
        share = float(stats["embree_cpu_seconds"]) / total  # type: ignore[arg-type]
        yield Row(f"CPU time inside Embree, {triangles} triangles", f"{share:.0%}")


def instruction_sets(_: Bench) -> Iterator[Row]:
    """The same ball on every instruction set: batches and packets of 4, 8 and 16 lanes."""
    program = ROOT / "tests/bench/instruction_set.py"
    rates = {}
    triangles = "5000"
    for isa in ("v2", "v3", "v4"):
        result = subprocess.run(
            [sys.executable, program, isa, triangles], check=False, capture_output=True, text=True, cwd=ROOT
        )
        if result.returncode == 0:
            rates[isa] = float(result.stdout)
    for isa, rate in rates.items():
        ratio = f"{rate / rates['v2']:.2f} x of v2" if "v2" in rates else ""
        yield Row(f"samples per second on x86-64-{isa}, one thread", f"{rate / 1e6:.2f} M, {ratio}")


def flat(bench: Bench) -> Iterator[Row]:
    """Five million triangles in one mesh: memory, and how fast points are translated."""
    stage = bench.folder / "flat.usdc"
    grid = scenes.write_flat(stage, 500_000 if bench.quick else 5_000_000)
    small = bench.folder / "small.usdc"
    scenes.write_flat(small, 1_000)
    options = ("--size", "256x256", "--spp", "4")
    base, stats = bench.render(small, *options), bench.render(stage, *options)
    grown = float(stats["peak_memory_bytes"]) - float(base["peak_memory_bytes"])  # type: ignore[arg-type]
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
    peak = float(stats["peak_memory_bytes"]) / 1e6  # type: ignore[arg-type]
    yield Row(f"peak memory, {triangles} instanced triangles", f"{peak:.0f} MB")
    yield Row("seconds to open, translate, commit", seconds(stats))


def seconds(stats: dict[str, dict[str, float]]) -> str:
    """The parts of a render before its first sample."""
    return ", ".join(f"{stats['seconds'][part]:.2f}" for part in ("open", "translate", "commit"))


def first_tile(bench: Bench) -> Iterator[Row]:
    """From the request to the first tile on a running server with a warm worker."""
    stage = bench.folder / "room5000.usdc"
    if not stage.exists():
        scenes.write_room(stage, 5_000)
    latencies = service.first_tile_seconds(stage, 3 if bench.quick else 9)
    middle = statistics.median(latencies)
    yield Row("first tile after the request", f"{middle:.3f} s (worst {max(latencies):.3f})", "<= 0.3 s", middle <= 0.3)


def streaming(bench: Bench) -> Iterator[Row]:
    """What streaming tiles adds to the time of rendering, pairs in turns."""
    stage = bench.folder / "room5000.usdc"
    if not stage.exists():
        scenes.write_room(stage, 5_000)
    costs = [on / off - 1 for on, off in service.streaming_pairs(stage, 2 if bench.quick else 5)]
    cost = statistics.median(costs)
    yield Row("cost of streaming", f"{cost:+.1%} of render time", "< 5 %", cost < 0.05)


FIGURES: dict[str, Callable[[Bench], Iterator[Row]]] = {
    "threads": threads,
    "embree": embree,
    "instruction_sets": instruction_sets,
    "first_tile": first_tile,
    "streaming": streaming,
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
    print(f"{'figure':52} {'measured':32} {'aim':10}")
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), arguments.quick)
        for name in arguments.figures or FIGURES:
            for row in FIGURES[name](bench):
                mark = {None: "", True: "met", False: "missed"}[row.met]
                print(f"{row.figure:52} {row.value:32} {row.aim:10} {mark}", flush=True)


if __name__ == "__main__":
    main()
