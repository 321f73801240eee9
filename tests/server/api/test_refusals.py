"""Bad requests: each is refused at once, with its code, its reason and every field at fault."""

import os
from collections.abc import Awaitable, Callable
from pathlib import Path

import grpc
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from footlight.v1 import render_pb2, render_service_pb2, stage_service_pb2
from tests.server.api.service import StartServer, Stubs, connect


def details(error: grpc.aio.AioRpcError) -> tuple[str, dict[str, str]]:
    """The reason, and what is said of each field."""
    status = rpc_status.from_call(error)
    assert status is not None
    info, request = error_details_pb2.ErrorInfo(), error_details_pb2.BadRequest()
    for detail in status.details:
        detail.Unpack(info)
        detail.Unpack(request)
    assert info.domain == "footlight"
    return info.reason, {violation.field: violation.description for violation in request.field_violations}


BAD_FIELDS: list[tuple[str, dict[str, object]]] = [
    ("stage_path", {"stage_path": ""}),
    ("stage_path", {"stage_path": "relative.usda"}),
    ("stage_path", {"stage_path": "/a\0b.usda"}),
    ("camera_path", {"camera_path": "camera"}),
    ("width", {"width": 40000, "height": 10}),
    ("width", {"width": 32768, "height": 32768}),
    ("height", {"width": 100, "height": 0}),
    ("width", {"width": 0, "height": 100}),
    ("spp", {"spp": (1 << 20) + 1}),
    ("max_depth", {"max_depth": 1025}),
    ("threads", {"threads": 1025}),
    ("pixel_filter", {"pixel_filter": 99}),
    ("strategy", {"strategy": 99}),
    ("filter_width", {"filter_width": -1.0}),
    ("filter_width", {"filter_width": float("nan")}),
    ("filter_width", {"filter_width": 17.0}),
    ("time_code", {"time_code": float("inf")}),
    ("time_limit_seconds", {"time_limit_seconds": -1.0}),
    ("error_limit", {"error_limit": float("nan")}),
]


@pytest.mark.parametrize(("field", "options"), BAD_FIELDS)
async def test_a_bad_field_is_named(client: Stubs, stage: Path, field: str, options: dict[str, object]) -> None:
    spec = render_pb2.RenderSpec(**({"stage_path": str(stage)} | options))
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await client.renders.CreateRender(render_service_pb2.CreateRenderRequest(spec=spec), timeout=10)
    assert caught.value.code() == grpc.StatusCode.INVALID_ARGUMENT
    reason, fields = details(caught.value)
    assert reason == "INVALID_FIELD"
    assert set(fields) == {f"spec.{field}"}


async def test_all_bad_fields_are_named_at_once(client: Stubs, stage: Path) -> None:
    spec = render_pb2.RenderSpec(stage_path=str(stage), spp=1 << 30, max_depth=5000, strategy=7)
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await client.renders.CreateRender(render_service_pb2.CreateRenderRequest(spec=spec), timeout=10)
    assert set(details(caught.value)[1]) == {"spec.spp", "spec.max_depth", "spec.strategy"}


async def test_a_missing_stage_is_not_found(client: Stubs, tmp_path: Path) -> None:
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await client.create(tmp_path / "nowhere.usda")
    assert caught.value.code() == grpc.StatusCode.NOT_FOUND
    assert details(caught.value)[0] == "STAGE_NOT_FOUND"
    assert "nowhere.usda" in (caught.value.details() or "")


async def test_a_fifo_is_no_stage(client: Stubs, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo.usda")
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await client.create(tmp_path / "fifo.usda")
    assert caught.value.code() == grpc.StatusCode.INVALID_ARGUMENT


CALLS: dict[str, Callable[[Stubs, str], Awaitable[object]]] = {
    "GetRender": Stubs.get,
    "CancelRender": Stubs.cancel,
    "GetResult": Stubs.result,
    "WatchRender": Stubs.end,
}


@pytest.mark.parametrize("rpc", CALLS)
async def test_an_unknown_render_is_not_found(client: Stubs, rpc: str) -> None:
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await CALLS[rpc](client, "renders/none")
    assert caught.value.code() == grpc.StatusCode.NOT_FOUND
    assert details(caught.value)[0] == "RENDER_NOT_FOUND"


async def test_only_what_lies_below_a_root_is_rendered(start_server: StartServer, stage: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.mkdir()
    inside = root / "stage.usda"
    inside.write_text(stage.read_text())
    (root / "link.usda").symlink_to(stage)
    (root / "reaches.usda").write_text(f'#usda 1.0\ndef "World" (\n    references = @{stage}@</World>\n) {{}}\n')
    with start_server("--root", root) as server:
        async with connect(server) as client:
            for outside in (stage, root / "link.usda", root / ".." / "stage.usda"):
                with pytest.raises(grpc.aio.AioRpcError) as caught:
                    await client.create(outside)
                assert caught.value.code() == grpc.StatusCode.PERMISSION_DENIED
            good = await client.end(await client.create(inside, spp=1))
            assert good.state == render_pb2.RENDER_STATE_SUCCEEDED
            reaching = await client.end(await client.create(root / "reaches.usda", spp=1))
            assert reaching.state == render_pb2.RENDER_STATE_FAILED
            assert reaching.failure.reason == render_pb2.FAILURE_REASON_STAGE_UNREADABLE


FAILING: list[tuple[int, str, dict[str, object]]] = [
    (render_pb2.FAILURE_REASON_INVALID_ARGUMENT, "beauty", {"aovs": ["beauty"]}),
    (render_pb2.FAILURE_REASON_INVALID_ARGUMENT, "/World/none", {"camera_path": "/World/none"}),
    (render_pb2.FAILURE_REASON_INVALID_ARGUMENT, "warp", {"force_effects": ["warp"]}),
    (render_pb2.FAILURE_REASON_INVALID_ARGUMENT, "sepia", {"png": render_pb2.Png(view="sepia")}),
]


@pytest.mark.parametrize(("reason", "word", "options"), FAILING)
async def test_what_only_the_worker_knows_fails_the_render_by_name(
    client: Stubs, stage: Path, reason: int, word: str, options: dict[str, object]
) -> None:
    render = await client.end(await client.create(stage, **options))
    assert render.state == render_pb2.RENDER_STATE_FAILED
    assert render.failure.reason == reason
    assert word in render.failure.message


async def test_what_is_no_stage_says_which_file(client: Stubs, tmp_path: Path) -> None:
    broken = tmp_path / "broken.usda"
    broken.write_text("#usda 1.0\ndef Xform {{{\n")
    render = await client.end(await client.create(broken))
    assert render.failure.reason == render_pb2.FAILURE_REASON_STAGE_UNREADABLE
    assert "broken.usda" in render.failure.message


async def test_strict_refuses_what_would_be_left_out(client: Stubs, stage: Path) -> None:
    stage.write_text(stage.read_text() + '\ndef SphereLight "void" {\n    float inputs:radius = 0\n}\n')
    loose = await client.end(await client.create(stage, spp=1))
    assert "/void" in [line.prim_path for line in loose.report.left_out]
    strict = await client.end(await client.create(stage, spp=1, strict=True))
    assert strict.failure.reason == render_pb2.FAILURE_REASON_SCENE
    assert "/void" in strict.failure.message


async def test_explain_says_what_the_stage_calls_for(client: Stubs, stage: Path) -> None:
    request = stage_service_pb2.ExplainStageRequest(spec=render_pb2.RenderSpec(stage_path=str(stage)))
    answer = await client.stages.ExplainStage(request, timeout=30)
    active = {effect.name: list(effect.prim_paths) for effect in answer.report.effects if effect.active}
    assert active["area_lights"] == ["/World/lamp"]
    assert answer.report.pipeline[0] == "generate"
    assert answer.spec.camera_path == "/World/camera"
    assert answer.spec.width > 0


async def test_explain_refuses_what_it_cannot_open(client: Stubs, tmp_path: Path) -> None:
    broken = tmp_path / "broken.usda"
    broken.write_text("no stage")
    request = stage_service_pb2.ExplainStageRequest(spec=render_pb2.RenderSpec(stage_path=str(broken)))
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await client.stages.ExplainStage(request, timeout=30)
    assert caught.value.code() == grpc.StatusCode.FAILED_PRECONDITION
    assert details(caught.value)[0] == "STAGE_REFUSED"
