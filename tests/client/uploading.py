"""A real blob service for the client's tests, a line to it that breaks, a stage that refers to all kinds of files."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Self

from pxr import Sdf, Usd, UsdUtils

from footlight.v1 import blob_service_pb2_grpc
from footlight_server.api.auth import LocalGate
from footlight_server.api.blob_service import BlobService
from footlight_server.api.server import GrpcServer, Health, Service
from footlight_server.blobs.store import BlobStore


@contextlib.contextmanager
def blob_server(directory: Path, quota: int = 0) -> Iterator[tuple[str, BlobStore]]:
    """The address of a server with nothing but uploads, in a thread of its own, and its store."""
    store = BlobStore(directory / "blobs", quota)
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()

    async def start() -> tuple[GrpcServer, str]:
        add = blob_service_pb2_grpc.add_BlobServiceServicer_to_server
        service = Service("footlight.v1.BlobService", BlobService(store), add)
        server = GrpcServer([service], Health([service]), [LocalGate()])
        return server, await server.start(f"unix:{directory}/socket")

    server, address = asyncio.run_coroutine_threadsafe(start(), loop).result(10)
    try:
        yield address, store
    finally:
        asyncio.run_coroutine_threadsafe(server.stop(0), loop).result(10)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(10)
        loop.close()
        store.close()


class BreakingLine:
    """Forwards connections from `address` to a server, and cuts the first few after so many bytes each."""

    def __init__(self, directory: Path, target: str, cuts: list[int]) -> None:
        self.address = f"unix:{directory}/line"
        # [bytes] After each connection's; then none is cut.
        self.cuts = cuts
        # [bytes] That were forwarded to the server.
        self.sent = 0
        self._target = target.removeprefix("unix:")
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(f"{directory}/line")
        self._listener.listen()
        self._threads = [threading.Thread(target=self._accept)]
        self._open: list[socket.socket] = [self._listener]
        self._threads[0].start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for each in self._open:
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        for thread in self._threads:
            thread.join(10)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.socket(socket.AF_UNIX)
                far.connect(self._target)
                self._open += [near, far]
                budget = self.cuts.pop(0) if self.cuts else 1 << 62
                for source, sink, most in ((near, far, budget), (far, near, 1 << 62)):
                    thread = threading.Thread(target=self._forward, args=(source, sink, most, source is near))
                    self._threads.append(thread)
                    thread.start()

    def _forward(self, source: socket.socket, sink: socket.socket, most: int, counted: bool) -> None:
        with contextlib.suppress(OSError):
            while most > 0 and (data := source.recv(min(most, 1 << 16))):
                sink.sendall(data)
                most -= len(data)
                self.sent += len(data) if counted else 0
        for each in (source, sink):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)


def write_stage(directory: Path) -> Path:
    """A stage with sublayers, references, payloads, variants, clips, textures, UDIMs, a usdz, volumes, near and far."""
    show, library = directory / "show", directory / "library"
    for folder in (show / "layers", show / "tex", library):
        folder.mkdir(parents=True)
    for tile in (1001, 1002, 1011):
        (show / "tex" / f"wood.{tile}.exr").write_bytes(b"udim %d" % tile)
    for path, data in {
        show / "tex" / "a.png": b"texture a",
        library / "b.png": b"texture b",
        library / "fog.vdb": b"a volume",
        show / "smoke.0001.vdb": b"smoke 1",
        show / "smoke.0002.vdb": b"smoke 2",
    }.items():
        path.write_bytes(data)
    text = {
        show / "layers" / "set.usda": 'def Xform "S" {\n asset a = @../tex/a.png@\n asset b = @../../library/b.png@\n}',
        show / "ball.usda": 'def Xform "Ball" {\n def Sphere "shape" {}\n}',
        library / "box.usda": f'def Xform "Ball" {{\n def Cube "shape" {{\n  asset tex = @{library}/b.png@\n }}\n}}',
        show / "packed.usda": 'def Xform "Ball" {\n def Cone "shape" {}\n asset tex = @./tex/a.png@\n}',
        show / "clip.usda": 'def Xform "Ball" {\n double x.timeSamples = { 1: 2, 2: 5 }\n}',
        show / "main.usda": MAIN.replace("LIBRARY", str(library)),
    }  # fmt: skip
    for path, body in text.items():
        head = "" if path.name == "main.usda" else '#usda 1.0\n(\n    defaultPrim = "Ball"\n)\n'
        path.write_text(head + body + "\n")
    assert UsdUtils.CreateNewUsdzPackage(str(show / "packed.usda"), str(show / "pack.usdz"))
    (show / "packed.usda").unlink()
    return show / "main.usda"


MAIN = """#usda 1.0
(
    subLayers = [@./layers/set.usda@]
    expressionVariables = { string WHICH = "ball" }
)
def "Near" (
    references = @./ball.usda@
)
{
}
def "Far" (
    payload = @../library/box.usda@
)
{
}
def "Chosen" (
    references = @`"./${WHICH}.usda"`@
)
{
}
def "Packed" (
    references = @./pack.usdz@
)
{
}
def "Either" (
    variants = {
        string kind = "near"
    }
    prepend variantSets = "kind"
)
{
    variantSet "kind" = {
        "near" {
            asset q = @./tex/a.png@
        }
        "far" (
            references = @../library/box.usda@
        ) {
        }
    }
}
def "Files"
{
    asset udim = @./tex/wood.<UDIM>.exr@
    asset fog = @LIBRARY/fog.vdb@
    asset[] many = [@./tex/a.png@, @LIBRARY/b.png@]
    asset smoke.timeSamples = {
        1: @./smoke.0001.vdb@,
        2: @./smoke.0002.vdb@,
    }
}
def "Moving" (
    clips = {
        dictionary default = {
            asset[] assetPaths = [@./clip.usda@]
            string primPath = "/Ball"
            double2[] active = [(0, 0)]
            double2[] times = [(1, 1), (2, 2)]
            asset manifestAssetPath = @./clip.usda@
        }
    }
)
{
    double x
}
"""


def meaning(stage_path: Path) -> dict[str, object]:
    """What a stage says, with files as what they hold: prims, attributes, values at two times."""
    said: dict[str, object] = {}
    for variant in ("near", "far"):
        stage = Usd.Stage.Open(str(stage_path))
        stage.GetPrimAtPath("/Either").GetVariantSets().SetSelection("kind", variant)
        for prim in stage.Traverse():
            said[f"{variant} {prim.GetPath()}"] = prim.GetTypeName()
            for attribute in prim.GetAuthoredAttributes():
                for time in (1.0, 2.0):
                    value = attribute.Get(time)
                    said[f"{variant} {attribute.GetPath()} {time}"] = _value(value, stage_path.parent)
    assert said
    return said


def _value(value: object, anchor: Path) -> object:
    if isinstance(value, Sdf.AssetPath):
        return _held(value, anchor)
    if isinstance(value, Sdf.AssetPathArray):
        return [_held(path, anchor) for path in value]
    return value


def _held(path: Sdf.AssetPath, anchor: Path) -> object:
    if "<UDIM>" in path.path:
        pattern = path.path.removeprefix("./").replace("<UDIM>", "*")
        tiles = {found.name: found.read_bytes() for found in anchor.glob(pattern)}
        assert len(tiles) == 3, tiles
        return tiles
    assert path.resolvedPath, path.path
    if "[" in path.resolvedPath:  # inside a package
        package, _, inner = path.resolvedPath.partition("[")
        return bytes(Sdf.ZipFile.Open(package).GetFile(inner.rstrip("]")))
    return Path(path.resolvedPath).read_bytes()
