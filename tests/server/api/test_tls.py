"""TLS: who can speak to an address beyond this machine, and which certificates a server does not start with."""

from pathlib import Path

import grpc
import pytest
from cryptography.hazmat.primitives import serialization

from footlight.v1 import token_service_pb2
from footlight_server.api.tls import Tls, check_tls
from footlight_server.options import check_launch, parse_arguments
from tests.server.api.certificates import Authority
from tests.server.api.secured import bearer, outcome, start_secured

CHECK = "/grpc.health.v1.Health/Check"
LIST_RENDERS = "/footlight.v1.RenderService/ListRenders"


async def reaches(channel: grpc.aio.Channel) -> bool:
    """Whether anybody answers there in a second or two."""
    call = channel.unary_unary(CHECK)(b"", timeout=2)
    async with channel:
        return bool(await call.code() == grpc.StatusCode.OK)


async def test_only_who_trusts_the_authority_and_speaks_tls_is_answered(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    other = Authority(tmp_path / "other", "other").certificate.read_bytes()
    with start_secured(tmp_path) as server:
        assert await reaches(server.stranger())
        assert not await reaches(grpc.aio.insecure_channel(server.remote))
        assert not await reaches(grpc.aio.secure_channel(server.remote, grpc.ssl_channel_credentials()))
        assert not await reaches(grpc.aio.secure_channel(server.remote, grpc.ssl_channel_credentials(other)))
        assert await reaches(grpc.aio.insecure_channel(server.server.address))


async def test_a_client_authority_asks_for_a_certificate_besides_the_token(tmp_path: Path) -> None:
    for name in ("clients", "other"):
        (tmp_path / name).mkdir()
    clients, other = Authority(tmp_path / "clients", "clients"), Authority(tmp_path / "other", "other")
    with start_secured(tmp_path, "--tls-client-ca", clients.certificate) as server:
        root = server.authority.read_bytes()

        def channel(authority: Authority) -> grpc.aio.Channel:
            mine = authority.sign("client")
            credentials = grpc.ssl_channel_credentials(root, mine.key.read_bytes(), mine.certificate.read_bytes())
            return grpc.aio.secure_channel(server.remote, credentials)

        assert not await reaches(server.stranger())
        assert not await reaches(channel(other))
        secret = (await server.token(token_service_pb2.SCOPE_READ)).secret
        async with channel(clients) as known:
            assert (await outcome(known, LIST_RENDERS))[0] == grpc.StatusCode.UNAUTHENTICATED
            assert (await outcome(known, LIST_RENDERS, bearer(secret)))[0] == grpc.StatusCode.OK


def refusal(*options: object) -> str:
    """What is said of options that no server starts with."""
    with pytest.raises(ValueError) as caught:
        check_launch(parse_arguments([str(option) for option in options]), Path("/nowhere"))
    return str(caught.value)


def test_certificates_that_cannot_work_are_refused_at_the_start(tmp_path: Path) -> None:
    server, other = (Authority(tmp_path).sign(name) for name in ("server", "other"))
    key = serialization.load_pem_private_key(other.key.read_bytes(), None)
    encrypted = tmp_path / "encrypted.key"
    encrypted.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.BestAvailableEncryption(b"password"),
        )
    )
    junk = tmp_path / "junk"
    junk.write_text("no PEM")
    listen = ("--listen", "0.0.0.0:0", "--tls-cert")
    assert "--tls-cert and --tls-key: give both" in refusal(*listen, server.certificate)
    assert "key values mismatch" in refusal(*listen, server.certificate, "--tls-key", other.key)
    for wrong in (encrypted, junk):
        assert f"--tls-key {wrong}" in refusal(*listen, server.certificate, "--tls-key", wrong)
    assert f"--tls-cert {junk}" in refusal(*listen, junk, "--tls-key", server.key)
    pair = (*listen, server.certificate, "--tls-key", server.key)
    assert "/nowhere: not a file" in refusal(*pair, "--tls-client-ca", "/nowhere")
    assert f"--tls-client-ca {junk}" in refusal(*pair, "--tls-client-ca", junk)


def test_an_address_beyond_this_machine_needs_tls_and_tls_such_an_address(tmp_path: Path) -> None:
    for address in ("0.0.0.0:0", "[::]:1", "192.168.1.2:1", "example.org:1"):
        assert "without TLS (--tls-cert and --tls-key)" in refusal("--listen", address)
    pair = Authority(tmp_path).sign("server")
    tls = ("--tls-cert", pair.certificate, "--tls-key", pair.key)
    assert "every --listen is a loopback address" in refusal("--listen", "127.0.0.1:0", *tls)
    assert "private" in refusal("--private", "--listen", "0.0.0.0:0", *tls)


@pytest.mark.parametrize(("mode", "warns"), [(0o600, False), (0o640, True), (0o604, True)])
def test_a_key_that_others_can_read_is_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, mode: int, *, warns: bool
) -> None:
    pair = Authority(tmp_path).sign("server")
    pair.key.chmod(mode)
    assert check_tls(pair.certificate, pair.key, None) == Tls(pair.certificate, pair.key)
    assert ("chmod 600" in caplog.text) == warns


async def test_who_listens_beyond_this_machine_is_told_what_is_open(tmp_path: Path) -> None:
    open_log, closed_log = tmp_path / "open.log", tmp_path / "closed.log"
    with start_secured(tmp_path, stderr=open_log):
        pass
    with start_secured(tmp_path, "--root", tmp_path, "--output-root", tmp_path, stderr=closed_log):
        pass
    assert "without --root" in open_log.read_text()
    assert "without --output-root" in open_log.read_text()
    assert "without --" not in closed_log.read_text()
