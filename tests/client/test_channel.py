"""A token goes over TLS and nowhere else; who cannot be trusted is not spoken to."""

from collections.abc import Iterator
from concurrent import futures
from pathlib import Path

import grpc
import pytest

from footlight import AsyncClient, Client
from footlight.channel import Credentials, is_local, open_channel
from footlight.errors import CredentialsError, ProtocolError, ServerUnavailableError
from tests.server.api.certificates import Authority

TOKEN = "footlight_secret"


class Listening(grpc.ServerInterceptor):  # type: ignore[misc]
    """Notes what a client shows with each call."""

    def __init__(self) -> None:
        self.shown: list[str] = []

    def intercept_service(self, continuation: object, details: grpc.HandlerCallDetails) -> None:
        del continuation
        metadata = dict(details.invocation_metadata)
        self.shown.append(metadata.get("authorization", ""))


@pytest.fixture
def server(tmp_path: Path) -> Iterator[tuple[str, str, Path, Listening]]:
    """A TLS address, a plain one, the authority, and what clients showed. It knows no method."""
    authority = Authority(tmp_path)
    files = authority.sign("server")
    listening = Listening()
    server = grpc.server(futures.ThreadPoolExecutor(2), interceptors=[listening])
    pair = [(files.key.read_bytes(), files.certificate.read_bytes())]
    secure = server.add_secure_port("127.0.0.1:0", grpc.ssl_server_credentials(pair, None, require_client_auth=False))
    plain = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield f"127.0.0.1:{secure}", f"127.0.0.1:{plain}", authority.certificate, listening
    server.stop(None).wait()


def test_a_token_goes_over_tls_only(server: tuple[str, str, Path, Listening]) -> None:
    secure, plain, ca, listening = server
    for address, options in ((secure, {"ca": ca}), (plain, {})):
        with Client(address, token=TOKEN, **options) as client, pytest.raises(ProtocolError, match="not found"):
            client.farm.workers()
    assert listening.shown == [f"Bearer {TOKEN}", ""]


async def test_the_same_with_asyncio(server: tuple[str, str, Path, Listening]) -> None:
    secure, _, ca, listening = server
    async with AsyncClient(secure, token=TOKEN, ca=ca) as client:
        with pytest.raises(ProtocolError, match="not found"):
            await client.farm.workers()
    assert listening.shown == [f"Bearer {TOKEN}"]


def test_a_server_that_nobody_vouches_for_gets_nothing(
    server: tuple[str, str, Path, Listening], tmp_path: Path
) -> None:
    secure, plain, ca, listening = server
    (tmp_path / "other").mkdir()
    other = Authority(tmp_path / "other").certificate
    for address, trusted, says in (
        (secure, other, "not signed by one that is trusted"),
        (plain, ca, "does not speak TLS"),
        (secure, None, "if it speaks TLS"),
    ):
        with (
            Client(address, token=TOKEN, ca=trusted) as client,
            pytest.raises(ServerUnavailableError, match=f"{address}: .*{says}"),
        ):
            client.farm.workers()
    assert listening.shown == []


def test_what_is_on_this_machine() -> None:
    local = ["unix:/a", "unix-abstract:a", "localhost:1", "127.0.0.1:1", "127.8.8.8:1", "[::1]:1"]
    remote = ["example.org:1", "10.0.0.1:1", "0.0.0.0:1", "[2001:db8::1]:1", "localhost.example.org:1"]
    assert all(map(is_local, local))
    assert not any(map(is_local, remote))


def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    (tmp_path / "empty.pem").write_text("")
    for credentials, says in (
        (Credentials(ca=tmp_path / "gone.pem"), "gone.pem cannot be read: No such file"),
        (Credentials(ca=tmp_path / "empty.pem"), "empty.pem is not a PEM file"),
        (Credentials(certificate=tmp_path / "empty.pem"), "go together"),
    ):
        with pytest.raises(CredentialsError, match=says):
            open_channel("127.0.0.1:1", credentials)
