"""Hostile stages at a real server: clear words in the end, or an image without what is outside; the server goes on."""

import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import grpc
import pytest

from footlight.upload.blobs import _send, untold
from footlight.upload.bundle import make_bundle
from footlight.v1 import render_pb2, render_service_pb2, render_service_pb2_grpc
from tests.e2e.hostile import BURDENS, ESCAPES, GOOD, LIMITS, SECRET, End, Make, outside
from tests.means import MEANS, require

ENDED = {render_pb2.RENDER_STATE_SUCCEEDED, render_pb2.RENDER_STATE_FAILED, render_pb2.RENDER_STATE_CANCELLED}
# [s] For all stages of a server.
PATIENCE = 200.0


@dataclass(frozen=True, slots=True)
class Server:
    """A running server and how stages get to it."""

    means: str
    process: subprocess.Popen[str]
    address: str
    # Below it stages are read by path; None: they are uploaded.
    root: Path | None
    log: Path
    channel: grpc.Channel

    @property
    def renders(self) -> render_service_pb2_grpc.RenderServiceStub:
        return render_service_pb2_grpc.RenderServiceStub(self.channel)

    def start(self, folder: Path, name: str) -> str:
        """Have the stage of that name in a folder rendered; the render's name."""
        spec = render_pb2.RenderSpec(stage_path=str(folder / name), width=8, height=8, spp=1, threads=1)
        if self.root is None:
            bundle = make_bundle(folder)
            _send(self.channel, self.address, bundle, untold)
            spec.bundle, spec.stage_path = bundle.digest, name
        request = render_service_pb2.CreateRenderRequest(spec=spec)
        return str(self.renders.CreateRender(request, timeout=10).render.name)

    def end_of(self, name: str, deadline: float) -> render_pb2.Render:
        """The render when it has ended."""
        while time.monotonic() < deadline:
            render = self.renders.GetRender(render_service_pb2.GetRenderRequest(name=name), timeout=10).render
            if render.state in ENDED:
                return render  # type: ignore[no-any-return]
            time.sleep(0.02)
        raise TimeoutError(f"{name} has not ended")


def serve(means: str, place: Path, *options: str, root: Path | None = None, launcher: str = "") -> Server:
    """Start a server below `place` that has these means to confine. `launcher`: Python to run in its process first."""
    program = f"{launcher}\nimport sys, footlight_server.__main__\nfootlight_server.__main__.main(sys.argv[1:])"
    address = f"unix:{place}/socket"
    arguments = ["--listen", address, "--data", str(place / "data"), "--workers", "2", "--farm-workers", "0"]
    if root is not None:
        arguments += ["--root", str(root)]
    log = place / "log"
    with log.open("w") as errors:
        process = subprocess.Popen(
            [sys.executable, "-c", program, *arguments, *LIMITS, *options],
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            # Where bubblewrap is not on the path, it is not installed.
            env=os.environ if means == "bubblewrap" else os.environ | {"PATH": str(place)},
        )
    assert process.stdout is not None
    ready = select.select([process.stdout], [], [], 30)[0] and process.stdout.readline().startswith("listening")
    if not ready:
        process.kill()
        raise AssertionError(log.read_text())
    return Server(means, process, address, root, log, grpc.insecure_channel(address))


def stop(server: Server) -> None:
    server.channel.close()
    server.process.terminate()
    try:
        assert server.process.wait(20) == 0
    finally:
        server.process.kill()
        assert server.process.stdout is not None
        server.process.stdout.close()


@pytest.fixture(scope="module", params=[*MEANS, "root"])
def server(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """One that confines what is uploaded, by either means, and one that reads below a root and confines nothing."""
    if request.param in MEANS:
        require(request.param)
    place = tmp_path_factory.mktemp("server")
    root = place / "root" if request.param == "root" else None
    if root is not None:
        root.mkdir()
    running = serve(request.param, place, root=root)
    try:
        yield running
    finally:
        stop(running)


def plain(render: render_pb2.Render) -> str:
    """All that the render says, but for what we asked of it."""
    copy = render_pb2.Render()
    copy.CopyFrom(render)
    copy.ClearField("spec")
    return str(copy)


def faults(render: render_pb2.Render, end: End, baseline: render_pb2.Render) -> list[str]:
    """How the end of a hostile stage is not what it should be."""
    found = []
    reason = render_pb2.FailureReason.Name(render.failure.reason).removeprefix("FAILURE_REASON_")
    if (reason if render.state == render_pb2.RENDER_STATE_FAILED else "") != end.reason:
        found.append(f"ended with {reason}: {plain(render)}")
    if end.says not in (render.failure.message if end.reason else plain(render)):
        found.append(f"does not say {end.says!r}: {plain(render)}")
    if SECRET in plain(render) or "root:" in plain(render):
        found.append(f"tells a secret: {plain(render)}")
    if not end.reason and render.stats.counts["triangles"] != baseline.stats.counts["triangles"]:
        found.append(f"shows {render.stats.counts['triangles']} triangles")
    return found


def test_hostile_stages_end_in_clear_words_and_the_server_goes_on(server: Server, tmp_path: Path) -> None:
    place = server.root or tmp_path / "stages"
    place.mkdir(exist_ok=True)
    away = outside(place.parent / "outside")
    deadline = time.monotonic() + PATIENCE

    def begin(name: str, make: Make) -> str:
        folder = place / name.replace("/", " ")
        folder.mkdir()
        return server.start(folder, make(folder, away))

    # What is too much is so whatever confines the worker.
    stages = {**ESCAPES, **(BURDENS if server.means != "landlock" else {})}
    ends = {name: stage.trusted if server.root else stage.uploaded for name, stage in stages.items()}
    baseline = server.end_of(begin("good", harmless), deadline)
    assert baseline.state == render_pb2.RENDER_STATE_SUCCEEDED, baseline
    started = {name: begin(name, stages[name].make) for name, end in ends.items() if end is not None}
    wrong = {}
    for name, render in started.items():
        end = ends[name]
        assert end is not None
        if found := faults(server.end_of(render, deadline), end, baseline):
            wrong[name] = found
    assert wrong == {}
    after = server.end_of(begin("good after all", harmless), deadline)
    assert after.stats.counts == baseline.stats.counts
    assert server.process.poll() is None
    log = server.log.read_text()
    assert SECRET not in log
    assert server.root is not None or f"confined by {server.means}" in log


def harmless(folder: Path, _: Path) -> str:
    """A stage that means no harm."""
    (folder / "stage.usda").write_text(f"#usda 1.0\n{GOOD}")
    return "stage.usda"


# Makes the kernel one that has no Landlock: the calls that make a ruleset answer that there are none.
WITHOUT_LANDLOCK = """
import errno, pyseccomp
rules = pyseccomp.SyscallFilter(pyseccomp.ALLOW)
rules.add_rule(pyseccomp.ERRNO(errno.ENOSYS), "landlock_create_ruleset")
rules.load()
"""


@pytest.mark.parametrize("trust", [False, True])
def test_where_nothing_confines_uploads_are_refused_unless_they_are_trusted(tmp_path: Path, trust: bool) -> None:
    options = ["--trust-scenes"] if trust else []
    server = serve("none", tmp_path, *options, launcher=WITHOUT_LANDLOCK)
    try:
        stage = tmp_path / "stage"
        stage.mkdir()
        name = harmless(stage, tmp_path)
        deadline = time.monotonic() + PATIENCE
        render = server.end_of(server.start(stage, name), deadline)
        if trust:
            assert render.state == render_pb2.RENDER_STATE_SUCCEEDED, render
        else:
            assert render.failure.reason == render_pb2.FAILURE_REASON_STAGE_UNREADABLE
            assert "--trust-scenes" in render.failure.message
            assert "bubblewrap: not installed" in render.failure.message
            assert "landlock: " in render.failure.message
        # The same file by its path is the owner's own.
        spec = render_pb2.RenderSpec(stage_path=str(stage / name), width=8, height=8, spp=1)
        request = render_service_pb2.CreateRenderRequest(spec=spec)
        trusted = server.renders.CreateRender(request, timeout=10).render.name
        assert server.end_of(trusted, deadline).state == render_pb2.RENDER_STATE_SUCCEEDED
    finally:
        stop(server)
