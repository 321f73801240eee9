"""Who gets in: every method against every scope, and what becomes of calls whose token is revoked or out of date."""

import asyncio
import contextlib
import getpass
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import grpc
import pytest
from google.protobuf import descriptor_pb2
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc

from footlight.v1 import render_pb2, render_service_pb2, render_service_pb2_grpc, token_service_pb2
from footlight_server.api.scopes import SCOPES
from footlight_server.farm.token_book import hashed, new_secret
from footlight_server.farm.tokens import SECRET, Scope
from tests.server.api.secured import Secured, bearer, outcome, reason_of, start_secured
from tests.server.api.service import LONG, STAGE, connect

READ, SUBMIT, ADMIN = token_service_pb2.SCOPE_READ, token_service_pb2.SCOPE_SUBMIT, token_service_pb2.SCOPE_ADMIN
WORDS: dict[int, Scope] = {READ: Scope.READ, SUBMIT: Scope.SUBMIT, ADMIN: Scope.ADMIN}

REFUSED = (grpc.StatusCode.UNAUTHENTICATED, "TOKEN_REQUIRED")
TOO_LITTLE = (grpc.StatusCode.PERMISSION_DENIED, "SCOPE_REQUIRED")
LIST_RENDERS = "/footlight.v1.RenderService/ListRenders"


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    with start_secured(tmp_path_factory.mktemp("secured"), "--root", "/", "--output-root", "/") as server:
        yield server


async def methods(channel: grpc.aio.Channel) -> set[str]:
    """All that a server answers to, as its reflection says."""
    call = reflection_pb2_grpc.ServerReflectionStub(channel).ServerReflectionInfo(timeout=20)
    await call.write(reflection_pb2.ServerReflectionRequest(list_services=""))
    names = [service.name for service in (await call.read()).list_services_response.service]
    found = set()
    for name in names:
        await call.write(reflection_pb2.ServerReflectionRequest(file_containing_symbol=name))
        files = (await call.read()).file_descriptor_response.file_descriptor_proto
        for file in map(descriptor_pb2.FileDescriptorProto.FromString, files):
            for service in file.service:
                if f"{file.package}.{service.name}" == name:
                    found |= {f"/{name}/{method.name}" for method in service.method}
    call.cancel()
    return found


async def test_every_method_of_every_service_has_a_scope(secured: Secured) -> None:
    async with grpc.aio.insecure_channel(secured.server.address) as channel:
        assert await methods(channel) == set(SCOPES)


def needed(method: str) -> Scope | None:
    """The scope by the words of the protocol: reading methods need `read`, the others `submit`, some `admin`."""
    service, _, name = method.removeprefix("/").partition("/")
    if method == "/grpc.health.v1.Health/Check":
        return None
    if service.endswith("TokenService") or name == "SetLimit":
        return Scope.ADMIN
    reads = name.startswith(("Get", "List", "Watch", "Read", "ExplainWait", "ServerReflection"))
    return Scope.READ if reads and not service.endswith("BlobService") else Scope.SUBMIT


def test_the_table_says_what_the_protocol_says() -> None:
    assert {method: needed(method) for method in SCOPES} == SCOPES


@pytest.mark.parametrize("scope", [READ, SUBMIT, ADMIN])
async def test_a_token_opens_the_methods_of_its_scope_and_no_others(secured: Secured, scope: int) -> None:
    metadata = bearer((await secured.token(scope)).secret)
    wrong = []
    async with secured.stranger() as channel:
        for method, needed in SCOPES.items():
            code, reason = await outcome(channel, method, metadata)
            refused = (code, reason) in (TOO_LITTLE, REFUSED)
            # gRPC's own health service has a method that it does not implement.
            refused |= code == grpc.StatusCode.UNIMPLEMENTED and not method.endswith("Health/List")
            if refused == (needed is None or WORDS[scope].includes(needed)):
                wrong.append((method, code, reason))
    assert wrong == []


async def test_without_a_token_nothing_opens_but_the_health_check(secured: Secured) -> None:
    async with secured.stranger() as channel:
        for method, needed in SCOPES.items():
            assert (await outcome(channel, method) == REFUSED) == (needed is not None), method


async def test_what_is_no_valid_token_opens_nothing(secured: Secured) -> None:
    secret = (await secured.token(ADMIN)).secret
    headers = [
        f"Bearer {new_secret()}",
        f"Bearer {secret[:-1]}",
        f"Bearer {secret}x",
        f"Bearer {hashed(secret)}",
        f"Basic {secret}",
        secret,
        "Bearer",
        "",
    ]
    async with secured.stranger() as channel:
        for header in headers:
            assert await outcome(channel, LIST_RENDERS, (("authorization", header),)) == REFUSED, header
        assert await outcome(channel, LIST_RENDERS, bearer(secret) + bearer(new_secret())) == REFUSED
        assert (await outcome(channel, LIST_RENDERS, (("authorization", f"bearer {secret}"),)))[0] == grpc.StatusCode.OK


async def test_a_stranger_is_refused_before_a_message_is_waited_for(secured: Secured) -> None:
    revoked = await secured.token(READ)
    await secured.revoke(revoked.token.name)
    async with secured.stranger() as channel:
        for metadata in ((), bearer(new_secret()), bearer(revoked.secret)):
            # Unary in the protocol: a handler of that kind would be called once the message is there, and none comes.
            call = channel.stream_stream(LIST_RENDERS)(metadata=metadata, timeout=20)
            async with asyncio.timeout(5):
                assert await call.code() == grpc.StatusCode.UNAUTHENTICATED


async def test_a_revoked_token_opens_nothing_any_more(secured: Secured) -> None:
    made = await secured.token(READ)
    async with secured.stranger() as channel:
        assert (await outcome(channel, LIST_RENDERS, bearer(made.secret)))[0] == grpc.StatusCode.OK
        await secured.revoke(made.token.name)
        assert await outcome(channel, LIST_RENDERS, bearer(made.secret)) == REFUSED
        await secured.revoke(made.token.name)


async def test_a_call_whose_message_comes_after_its_token_was_revoked_is_refused(secured: Secured) -> None:
    made = await secured.token(READ)
    async with secured.stranger() as channel:
        call = channel.stream_stream(LIST_RENDERS)(metadata=bearer(made.secret), timeout=20)
        await call.wait_for_connection()
        await asyncio.sleep(0.3)
        await secured.revoke(made.token.name)
        with contextlib.suppress(grpc.aio.AioRpcError):
            await call.write(b"")
        # A client that still writes when its call ends may see that as INTERNAL (gRPC 1.85).
        ended = await ends(call, 5)
        assert ended == REFUSED or ended[0] == grpc.StatusCode.INTERNAL


async def watching(channel: grpc.aio.Channel, name: str, secret: str) -> grpc.aio.StreamStreamCall:
    """A stream that goes on as long as the render; its first event has come."""
    call = render_service_pb2_grpc.RenderServiceStub(channel).WatchRender(metadata=bearer(secret), timeout=60)
    await call.write(render_service_pb2.WatchRenderRequest(subscribe=render_service_pb2.Subscribe(name=name)))
    assert (await call.read()).HasField("render")
    return call


async def ends(call: grpc.aio.StreamStreamCall, within: float) -> tuple[grpc.StatusCode, str]:
    async with asyncio.timeout(within):
        with contextlib.suppress(grpc.aio.AioRpcError):
            while await call.read() is not grpc.aio.EOF:
                pass
        return await call.code(), await reason_of(call)


async def test_open_streams_end_with_their_token_and_no_others(secured: Secured, tmp_path: Path) -> None:
    stage = tmp_path / "stage.usda"
    stage.write_text(STAGE)
    async with connect(secured.server) as local, secured.stranger() as channel:
        name = await local.create(stage, spp=LONG, width=16, height=16, threads=1)
        revoked, kept = await secured.token(READ), await secured.token(READ)
        expiring = await secured.token(READ, expires=time.time() + 3)
        streams = [await watching(channel, name, made.secret) for made in (revoked, revoked, kept, expiring)]
        await secured.revoke(revoked.token.name)
        assert [await ends(stream, 2) for stream in streams[:2]] == [REFUSED, REFUSED]
        assert await ends(streams[3], 5) == REFUSED
        assert await outcome(channel, LIST_RENDERS, bearer(expiring.secret)) == REFUSED
        assert not streams[2].done()
        await local.cancel(name)
        ended = await local.end(name)
        assert ended.state == render_pb2.RENDER_STATE_CANCELLED
        assert await ends(streams[2], 10) == (grpc.StatusCode.OK, "")


async def test_the_list_tells_everything_but_secrets(secured: Secured) -> None:
    before = time.time()
    made = await secured.token(SUBMIT, user="grace@hopper")
    assert SECRET.fullmatch(made.secret)
    async with secured.stranger() as channel:
        await outcome(channel, LIST_RENDERS, bearer(made.secret))
    async with secured.owner() as tokens:
        listed = await tokens.ListTokens(token_service_pb2.ListTokensRequest(), timeout=10)
    found = {token.name: token for token in listed.tokens}[made.token.name]
    assert (found.user, found.scope, found.comment) == ("grace@hopper", SUBMIT, "for a test")
    assert before - 1 < found.create_time.ToSeconds() <= time.time()
    assert not found.HasField("revoke_time")
    assert not found.HasField("expire_time")
    assert found.last_use_time.ToSeconds() % 3600 == 0
    assert 0 <= time.time() - found.last_use_time.ToSeconds() < 3600
    assert made.secret.encode() not in listed.SerializeToString()


@pytest.mark.parametrize(
    ("asked", "field"),
    [
        ({"user": "", "scope": READ}, "user"),
        ({"user": "a b", "scope": READ}, "user"),
        ({"user": "a" * 65, "scope": READ}, "user"),
        ({"user": "a\n", "scope": READ}, "user"),
        ({"user": "a"}, "scope"),
        ({"user": "a", "scope": 9}, "scope"),
        ({"user": "a", "scope": READ, "comment": "x" * 4097}, "comment"),
        ({"user": "a", "scope": READ, "expire_time": {"seconds": 1}}, "expire_time"),
        ({"user": "a", "scope": READ, "expire_time": {"nanos": -1}}, "expire_time"),
    ],
)
async def test_what_is_wrong_with_a_token_is_named(secured: Secured, asked: dict[str, object], field: str) -> None:
    async with secured.owner() as tokens:
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await tokens.CreateToken(token_service_pb2.CreateTokenRequest(**asked), timeout=10)
    assert caught.value.code() == grpc.StatusCode.INVALID_ARGUMENT
    assert str(caught.value.details()).startswith(f"{field}: ")


@pytest.mark.parametrize("name", ["", "tokens/", "tokens/999999", "tokens/-1", "tokens/" + "9" * 30, "jobs/1"])
async def test_a_token_that_is_not_there_is_not_found(secured: Secured, name: str) -> None:
    async with secured.owner() as tokens:
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await tokens.RevokeToken(token_service_pb2.RevokeTokenRequest(name=name), timeout=10)
    assert caught.value.code() == grpc.StatusCode.NOT_FOUND


async def test_secrets_are_neither_kept_nor_logged_and_outlive_the_server_as_hashes(tmp_path: Path) -> None:
    data, log, unknown = tmp_path / "data", tmp_path / "log", new_secret()
    with start_secured(tmp_path, "--data", data, "--verbose", stderr=log) as server:
        kept, revoked = await server.token(READ), await server.token(READ)
        async with server.stranger() as channel:
            for made in (kept, revoked):
                assert (await outcome(channel, LIST_RENDERS, bearer(made.secret)))[0] == grpc.StatusCode.OK
            assert await outcome(channel, LIST_RENDERS, bearer(unknown)) == REFUSED
        await server.revoke(revoked.token.name)
    written = b"".join(path.read_bytes() for path in data.rglob("*") if path.is_file())
    assert hashed(kept.secret).encode() in written
    assert LIST_RENDERS in log.read_text()
    for secret in (kept.secret, revoked.secret, unknown):
        assert secret.encode() not in written
        assert secret not in log.read_text()
        assert re.search(re.escape(secret[10:30]), log.read_text()) is None
    with start_secured(tmp_path, "--data", data) as server:
        async with server.stranger() as channel:
            assert (await outcome(channel, LIST_RENDERS, bearer(kept.secret)))[0] == grpc.StatusCode.OK
            assert await outcome(channel, LIST_RENDERS, bearer(revoked.secret)) == REFUSED


def test_a_logged_secret_is_made_useless() -> None:
    program = (
        "import logging, sys; from footlight_server import logs; logs.configure(sys.argv[1], logging.INFO);"
        "logging.error('a %s', sys.argv[2])\n"
        "try: raise ValueError(sys.argv[2])\n"
        "except ValueError: logging.exception('b')"
    )
    secret = new_secret()
    for form in ("text", "json"):
        done = subprocess.run([sys.executable, "-c", program, form, secret], capture_output=True, text=True, check=True)
        assert "ValueError" in done.stderr
        assert secret[10:] not in done.stderr


def test_the_owner_of_the_process_is_who_calls_locally() -> None:
    from footlight_server.api.auth import local_caller

    assert local_caller().user == getpass.getuser()
    assert local_caller().is_admin
