"""A server with everything: the queue, the farm, uploads, tokens. A private server does not load what this imports."""

import asyncio
import logging
import os
import time
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING

from footlight.v1 import (
    blob_service_pb2,
    blob_service_pb2_grpc,
    job_service_pb2,
    job_service_pb2_grpc,
    token_service_pb2,
    token_service_pb2_grpc,
)
from footlight_server.api.blob_service import BlobService
from footlight_server.api.job_service import JobService
from footlight_server.api.render_service import RenderService
from footlight_server.api.server import Service
from footlight_server.api.stage_service import StageService
from footlight_server.api.token_gate import TokenGate
from footlight_server.api.token_service import TokenService
from footlight_server.assembly import Parts, render_services
from footlight_server.blobs.bundle import BundleStore
from footlight_server.blobs.store import BlobStore
from footlight_server.blobs.sweep import Sweeper
from footlight_server.closing import closing
from footlight_server.farm.dispatcher import Farm
from footlight_server.farm.executor import Executor
from footlight_server.farm.local import LocalExecutor
from footlight_server.farm.places import Places
from footlight_server.farm.queue import Queue
from footlight_server.farm.token_book import TokenBook
from footlight_server.sessions.sessions import Sessions
from footlight_server.settings import Settings
from footlight_server.workers.sandbox import choose_sandbox

if TYPE_CHECKING:
    from footlight_server.metrics import Metrics

log = logging.getLogger(__name__)

# [s] For each part; the database may be on a slow disk.
_CLOSING = 10.0


async def farm_parts(settings: Settings, stack: AsyncExitStack, metrics: "Metrics | None") -> Parts:
    """What has to be closed once calls have ended is put on the stack.

    Raises DatabaseRefusedError if the database cannot be ours, StorageError.
    """
    if not settings.trust_scenes:
        # Once, and before anybody waits for it.
        log.info(await asyncio.to_thread(lambda: choose_sandbox().summary))
    places = Places(settings.data)
    queue = await Queue.open(settings.database)
    stack.push_async_callback(closing, "the database", queue.close, _CLOSING)
    book = TokenBook(queue)
    await book.load()
    stack.push_async_callback(closing, "the book of tokens", book.close, _CLOSING)
    blobs = BlobStore(places.blobs, settings.quota.bytes)
    stack.callback(blobs.close)
    bundles = BundleStore(blobs, places.bundles)
    stack.push_async_callback(closing, "the bundles", bundles.close, _CLOSING)
    sessions = Sessions(settings)

    async def bundles_in_use() -> set[str]:
        return await queue.bundles_in_use() | sessions.bundles_in_use()

    sweeper = Sweeper(blobs, bundles, bundles_in_use, settings.keep_blobs)
    stack.push_async_callback(closing, "the sweeper", sweeper.close, _CLOSING)
    sweeper.start()
    farm = Farm(settings, queue, sessions, _executor(settings), bundles, metrics)
    jobs = JobService(queue, farm, bundles, settings)
    if metrics is not None:
        from footlight_server.gauges import Gauges  # noqa: PLC0415 not everybody is watched

        gauges = Gauges(metrics, queue, farm, blobs)
        stack.push_async_callback(closing, "the gauges", gauges.close, _CLOSING)
        gauges.start()
    gate = TokenGate(book)
    services = (
        *render_services(RenderService(sessions, settings, bundles), StageService(sessions, settings, bundles)),
        Service(
            job_service_pb2.DESCRIPTOR.services_by_name["JobService"].full_name,
            jobs,
            job_service_pb2_grpc.add_JobServiceServicer_to_server,
        ),
        Service(
            blob_service_pb2.DESCRIPTOR.services_by_name["BlobService"].full_name,
            BlobService(blobs),
            blob_service_pb2_grpc.add_BlobServiceServicer_to_server,
        ),
        Service(
            token_service_pb2.DESCRIPTOR.services_by_name["TokenService"].full_name,
            TokenService(book, gate, time.time),
            token_service_pb2_grpc.add_TokenServiceServicer_to_server,
        ),
    )
    return Parts(sessions, services, farm, gate, jobs)


def _executor(settings: Settings) -> Executor:
    if settings.ray is None:
        return LocalExecutor(settings.farm_workers, settings.worker_memory)
    # An extra that few install.
    from footlight_server.farm.ray.environment import TlsFiles, access_of  # noqa: PLC0415
    from footlight_server.farm.ray.executor import RayExecutor  # noqa: PLC0415

    ray, tls = settings.ray, None
    if ray.certificate is not None and ray.key is not None and ray.authority is not None:
        tls = TlsFiles(ray.certificate, ray.key, ray.authority)
    return RayExecutor(ray.address, access_of(os.environ, ray.token_file, tls), settings.worker_memory)
