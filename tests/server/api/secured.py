"""A server that is reached over TLS with tokens, and locally by its owner; calls by name, whatever their kind."""

import contextlib
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path

import grpc
from google.protobuf.timestamp_pb2 import Timestamp
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from footlight.v1 import token_service_pb2, token_service_pb2_grpc
from tests.server.api.certificates import Authority
from tests.server.api.service import Server, start

Metadata = tuple[tuple[str, str], ...]


@dataclass
class Secured:
    """`server.address` is its owner's Unix socket; `remote` the address that others reach."""

    server: Server
    remote: str
    authority: Path

    def credentials(self) -> grpc.ChannelCredentials:
        return grpc.ssl_channel_credentials(self.authority.read_bytes())

    @contextlib.asynccontextmanager
    async def owner(self) -> AsyncIterator[token_service_pb2_grpc.TokenServiceStub]:
        """The tokens, by the socket that needs none."""
        async with grpc.aio.insecure_channel(self.server.address) as channel:
            yield token_service_pb2_grpc.TokenServiceStub(channel)

    def stranger(self) -> grpc.aio.Channel:
        """A connection from elsewhere, without a token."""
        return grpc.aio.secure_channel(self.remote, self.credentials())

    async def token(
        self, scope: int, user: str = "ada", expires: float | None = None
    ) -> token_service_pb2.CreateTokenResponse:
        """A new token. `expires`: [s since 1970]."""
        request = token_service_pb2.CreateTokenRequest(user=user, scope=scope, comment="for a test")
        if expires is not None:
            request.expire_time.CopyFrom(Timestamp(seconds=int(expires), nanos=int(expires % 1 * 1e9)))
        async with self.owner() as tokens:
            response: token_service_pb2.CreateTokenResponse = await tokens.CreateToken(request, timeout=10)
        return response

    async def revoke(self, name: str) -> None:
        async with self.owner() as tokens:
            await tokens.RevokeToken(token_service_pb2.RevokeTokenRequest(name=name), timeout=10)


@contextlib.contextmanager
def start_secured(directory: Path, *options: object, stderr: Path | None = None) -> Iterator[Secured]:
    """Certificates and socket are kept in the directory."""
    authority = Authority(directory)
    files = authority.sign("server")
    tls = ("--tls-cert", files.certificate, "--tls-key", files.key)
    listen = ("--listen", f"unix:{directory}/socket", "--listen", "0.0.0.0:0")
    with start(*listen, *tls, *options, listen=2, stderr=stderr) as server:
        port = server.addresses[1].rpartition(":")[2]
        yield Secured(server, f"127.0.0.1:{port}", authority.certificate)


def bearer(secret: str) -> Metadata:
    return (("authorization", f"Bearer {secret}"),)


async def outcome(channel: grpc.aio.Channel, method: str, metadata: Metadata = ()) -> tuple[grpc.StatusCode, str]:
    """Code and reason of a call with an empty request; OK as soon as an answer has come."""
    call = channel.stream_stream(method)(metadata=metadata, timeout=10)
    try:
        await call.write(b"")
        if await call.read() is not grpc.aio.EOF:
            return grpc.StatusCode.OK, ""
    except grpc.aio.AioRpcError:
        pass
    finally:
        call.cancel()
    return await call.code(), await reason_of(call)


async def reason_of(call: grpc.aio.Call) -> str:
    """What the error's ErrorInfo says, if it has one."""
    trailing = await call.trailing_metadata()
    details = [value for key, value in trailing or () if key == rpc_status.GRPC_DETAILS_METADATA_KEY]
    if not details:
        return ""
    from google.rpc import status_pb2

    info = error_details_pb2.ErrorInfo()
    for detail in status_pb2.Status.FromString(details[0]).details:
        if detail.Unpack(info):
            return str(info.reason)
    return ""
