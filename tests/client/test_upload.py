"""An upload brings to the server what the stage consists of, once, whatever happens to the line on the way."""

import random
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import grpc
import pytest
from hypothesis import given
from hypothesis import strategies as st

from footlight.client import AsyncClient, Client
from footlight.errors import (
    DigestMismatchError,
    FootlightError,
    InvalidRequestError,
    QuotaError,
    ServerUnavailableError,
    WrongOffsetError,
)
from footlight.upload import steps as stepping
from footlight.upload.bundle import LARGEST_SMALL, Blob, Bundle, BundleRef, batches, make_bundle
from footlight.upload.collect import CollectError, collected
from footlight.upload.steps import Step, Wait, Write, upload_steps
from footlight.v1 import blob_service_pb2, render_pb2
from footlight_server.blobs.bundle import BundleStore
from footlight_server.blobs.digest import Digest, digest_of
from footlight_server.blobs.store import BlobStore
from tests.client.uploading import BreakingLine, blob_server, meaning, write_stage

LARGE = random.Random(3).randbytes(3_000_000)


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    return write_stage(tmp_path / "work")


@pytest.fixture
def server(tmp_path: Path) -> Iterator[tuple[str, BlobStore]]:
    with blob_server(tmp_path) as found:
        yield found


# --- collecting ---


def test_what_is_collected_means_the_same_without_the_original(stage: Path, tmp_path: Path) -> None:
    before = meaning(stage)
    with collected(stage) as found:
        assert found.unresolved == ()
        (tmp_path / "work").rename(tmp_path / "gone")
        assert meaning(found.root / found.stage_path) == before
        assert not any(path.is_symlink() for path in found.root.rglob("*"))
        assert all(path.resolve().is_relative_to(found.root.resolve()) for path in found.root.rglob("*"))
    assert not found.root.exists()


def test_collecting_leaves_the_original_alone(stage: Path, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with collected(stage):
        pass
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_package_is_collected_with_all_it_holds(stage: Path) -> None:
    with collected(stage.parent / "pack.usdz") as found:
        assert found.stage_path == "pack.usdz"
        assert (found.root / "pack.usdz").read_bytes() == (stage.parent / "pack.usdz").read_bytes()


def test_references_that_lead_nowhere_are_said(stage: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (stage.parent / "tex" / "a.png").unlink()
    (stage.parent / "ball.usda").unlink()
    with collected(stage) as found:
        assert {Path(path).name for path in found.unresolved} == {"a.png", "ball.usda"}
        assert (found.root / "smoke.0001.vdb").exists()
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("text", ["", "not usd", "#usda 1.0\ndef Xform {"])
def test_what_is_no_stage_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "wrong.usda").write_text(text)
    with pytest.raises(CollectError, match=r"wrong\.usda"), collected(tmp_path / "wrong.usda"):
        pass
    with pytest.raises(CollectError, match="no such file"), collected(tmp_path / "nowhere.usda"):
        pass


def test_a_sublayer_that_cannot_be_read_is_named(stage: Path) -> None:
    (stage.parent / "layers" / "set.usda").write_text("#usda 1.0\ndef Xform {")
    with pytest.raises(CollectError, match=r"set\.usda"), collected(stage):
        pass


def test_without_pxr_a_package_goes_and_anything_else_says_what_is_missing(stage: Path) -> None:
    program = (
        "import sys; sys.modules['pxr'] = None\n"
        "from pathlib import Path\n"
        "from footlight.upload.collect import CollectError, collected\n"
        "with collected(Path(sys.argv[2])) as found: print(sorted(path.name for path in found.root.iterdir()))\n"
        "try:\n    with collected(Path(sys.argv[1])): pass\n"
        "except CollectError as error: print(error)\n"
    )
    command = [sys.executable, "-c", program, stage, stage.parent / "pack.usdz"]
    said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    assert said.startswith("['pack.usdz']\n")
    assert "pip install usd-core" in said


# --- what a bundle is ---


def test_the_same_files_make_the_same_bundle(stage: Path) -> None:
    with collected(stage) as first, collected(stage) as second:
        assert make_bundle(first.root).digest == make_bundle(second.root).digest
        (second.root / "tex" / "a.png").write_bytes(b"another")
        assert make_bundle(first.root).digest != make_bundle(second.root).digest


@given(st.lists(st.integers(0, LARGEST_SMALL), max_size=60), st.integers(0, 2500))
def test_batches_fit_into_a_call_and_hold_everything(sizes: list[int], empty: int) -> None:
    blobs = [Blob(f"{index:064x}", size, b"") for index, size in enumerate([*sizes, *([0] * empty)])]
    found = list(batches(blobs))
    assert [blob for batch in found for blob in batch] == blobs
    for batch in found:
        assert 0 < len(batch) <= 1000
        assert sum(blob.size for blob in batch) <= 900 << 10
        request = blob_service_pb2.UploadBlobsRequest()
        for blob in batch:
            request.blobs.add(digest=blob.digest, data=bytes(blob.size))
        assert request.ByteSize() < 1 << 20


def test_a_spec_is_told_what_to_render() -> None:
    spec = render_pb2.RenderSpec(stage_path="/tmp/a.usda", spp=3)
    BundleRef("d/1", "main.usda").into(spec)
    assert (spec.bundle, spec.stage_path, spec.spp) == ("d/1", "main.usda", 3)


# --- uploading ---


async def materialised(store: BlobStore, directory: Path, digest: str) -> Path:
    return await BundleStore(store, directory / "bundles").materialise(digest)


async def test_an_upload_arrives_as_it_was_meant(server: tuple[str, BlobStore], stage: Path, tmp_path: Path) -> None:
    (stage.parent / "tex" / "a.png").write_bytes(LARGE)
    before = meaning(stage)
    heard: list[tuple[int, int]] = []
    async with AsyncClient(server[0]) as client:
        bundle = await client.upload(stage, lambda done, total: heard.append((done, total)))
    assert heard == sorted(heard)
    assert heard[-1][0] == heard[-1][1] > len(LARGE)
    (tmp_path / "work").rename(tmp_path / "gone")
    root = await materialised(server[1], tmp_path, bundle.digest)
    assert meaning(root / bundle.stage_path) == before


def test_what_is_there_is_not_sent_again(server: tuple[str, BlobStore], stage: Path, tmp_path: Path) -> None:
    (stage.parent / "tex" / "a.png").write_bytes(LARGE)
    with Client(server[0]) as client:
        first = client.upload(stage)
        # Connections are cut long before the texture could have come again.
        with BreakingLine(tmp_path, server[0], [100_000] * 100) as line, Client(line.address) as narrow:
            assert narrow.upload(stage) == first
            (stage.parent / "ball.usda").write_text('#usda 1.0\n(defaultPrim = "Ball")\ndef Sphere "Ball" {}\n')
            assert narrow.upload(stage).digest != first.digest


async def test_an_upload_goes_on_where_the_line_broke(
    server: tuple[str, BlobStore], stage: Path, tmp_path: Path
) -> None:
    (stage.parent / "tex" / "a.png").write_bytes(LARGE)
    heard: list[int] = []
    cuts = [200_000, 1_200_000, 900_000, 50]
    # [bytes] Had it begun anew each time.
    wasteful = sum(cuts) + len(LARGE)
    with BreakingLine(tmp_path, server[0], cuts) as line, Client(line.address) as client:
        bundle = client.upload(stage, lambda done, _: heard.append(done))
        assert line.cuts == []
        assert line.sent < wasteful - 300_000
    assert heard[-1] > len(LARGE)
    root = await materialised(server[1], tmp_path, bundle.digest)
    assert (root / "tex" / "a.png").read_bytes() == LARGE


async def test_the_same_with_asyncio(server: tuple[str, BlobStore], stage: Path, tmp_path: Path) -> None:
    (stage.parent / "tex" / "a.png").write_bytes(LARGE)
    with BreakingLine(tmp_path, server[0], [1_200_000, 900_000]) as line:
        async with AsyncClient(line.address) as client:
            bundle = await client.upload(stage)
        assert line.cuts == []
    root = await materialised(server[1], tmp_path, bundle.digest)
    assert (root / "tex" / "a.png").read_bytes() == LARGE


def test_more_than_the_quota_is_said(stage: Path, tmp_path: Path) -> None:
    (stage.parent / "tex" / "a.png").write_bytes(LARGE)
    with blob_server(tmp_path, quota=1_000_000) as (address, _), Client(address) as client, pytest.raises(QuotaError):
        client.upload(stage)


async def test_the_same_with_asyncio_which_may_lose_the_answer_at_first(stage: Path, tmp_path: Path) -> None:
    (stage.parent / "tex" / "a.png").write_bytes(LARGE)
    with blob_server(tmp_path, quota=1_000_000) as (address, _):
        async with AsyncClient(address) as client:
            with pytest.raises(QuotaError):
                await client.upload(stage)


def test_a_server_without_uploads_says_so(stage: Path, tmp_path: Path) -> None:
    server = grpc.server(ThreadPoolExecutor(1))
    server.add_insecure_port(f"unix:{tmp_path}/socket")
    server.start()
    with Client(f"unix:{tmp_path}/socket") as client, pytest.raises(InvalidRequestError, match="takes no uploads"):
        client.upload(stage)
    server.stop(0).wait(10)


def test_a_server_that_is_not_there_is_not_waited_for(stage: Path, tmp_path: Path) -> None:
    with Client(f"unix:{tmp_path}/nobody") as client, pytest.raises(ServerUnavailableError):
        client.upload(stage)


# --- the steps alone ---


class Store:
    """What a server does with steps, and errors it answers with first, one for each step."""

    def __init__(self, errors: list[FootlightError | None]) -> None:
        self.errors = errors
        self.blobs: dict[str, bytes] = {}
        self.partial: dict[str, bytes] = {}
        self.waited = 0.0
        self.sent = 0

    def run(self, bundle: Bundle) -> None:
        steps = upload_steps(bundle, lambda _done, _total: None)
        try:
            step = next(steps)
            while True:
                error = self.errors.pop(0) if self.errors and not isinstance(step, Wait) else None
                step = steps.throw(error) if error else steps.send(self.take(step))
        except StopIteration:
            return

    def take(self, step: Step) -> object:
        if isinstance(step, Wait):
            self.waited += step.seconds
            return None
        if isinstance(step, Write):
            data = self.partial.get(step.blob.sha256, b"")
            for request in step.requests():
                assert request.offset == len(data)
                data += request.data
                self.sent += len(request.data)
            assert digest_of(data) == Digest(step.blob.sha256, step.blob.size)
            self.blobs[step.blob.sha256] = data
            return None
        return getattr(self, step.method)(step.request)

    def FindMissingBlobs(  # noqa: N802 the method's name
        self, request: blob_service_pb2.FindMissingBlobsRequest
    ) -> blob_service_pb2.FindMissingBlobsResponse:
        missing = [digest for digest in request.digests if digest.sha256 not in self.blobs]
        return blob_service_pb2.FindMissingBlobsResponse(missing=missing)

    def UploadBlobs(self, request: blob_service_pb2.UploadBlobsRequest) -> None:  # noqa: N802 the method's name
        self.blobs.update({blob.digest.sha256: blob.data for blob in request.blobs})

    def GetUpload(  # noqa: N802 the method's name
        self, request: blob_service_pb2.GetUploadRequest
    ) -> blob_service_pb2.GetUploadResponse:
        sha256 = request.digest.sha256
        return blob_service_pb2.GetUploadResponse(
            offset=len(self.partial.get(sha256, b"")), complete=sha256 in self.blobs
        )


@pytest.fixture
def bundle(tmp_path: Path) -> Bundle:
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "large").write_bytes(LARGE)
    (tmp_path / "files" / "small").write_bytes(b"small")
    return make_bundle(tmp_path / "files")


GONE = ServerUnavailableError("gone")
# FindMissing, UploadBlobs, GetUpload, Write.
COURSES: list[list[FootlightError | None]] = [
    [],
    [None, GONE, GONE, None],
    [None, None, GONE, None, GONE, None],
    [None, None, None, GONE, None, WrongOffsetError("elsewhere"), GONE],
    [None, None, None, DigestMismatchError("spoiled"), None, None],
]


@pytest.mark.parametrize("errors", COURSES)
def test_steps_that_fail_are_taken_again(bundle: Bundle, errors: list[FootlightError | None]) -> None:
    store = Store(list(errors))
    store.run(bundle)
    assert set(store.blobs) == {bundle.blob.sha256, *(blob.sha256 for blob in bundle.blobs)}
    assert store.waited < 5


def test_what_has_come_is_not_sent_again(bundle: Bundle) -> None:
    large = next(blob for blob in bundle.blobs if blob.size == len(LARGE))
    store = Store([])
    store.partial[large.sha256] = LARGE[:2_000_000]
    store.run(bundle)
    assert store.sent == 1_000_000


def test_a_server_that_stays_away_is_given_up(bundle: Bundle) -> None:
    store = Store([None, *([GONE] * 100)])
    with pytest.raises(ServerUnavailableError):
        store.run(bundle)
    assert 20 < store.waited < 60
    assert len(store.errors) == 100 - stepping._TRIES
    absent = Store([GONE])
    with pytest.raises(ServerUnavailableError):
        absent.run(bundle)
    assert absent.waited == 0


def test_bytes_that_are_spoiled_twice_are_given_up(bundle: Bundle) -> None:
    store = Store([None, None, None, DigestMismatchError("once"), None, DigestMismatchError("twice")])
    with pytest.raises(DigestMismatchError, match="twice"):
        store.run(bundle)


def test_a_refusal_is_final(bundle: Bundle) -> None:
    store = Store([None, QuotaError("full")])
    with pytest.raises(QuotaError):
        store.run(bundle)
    assert store.waited == 0
