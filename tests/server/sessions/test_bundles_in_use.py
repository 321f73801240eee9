"""A render needs its bundle from when it is accepted until it has ended; the sweep asks for that."""

import asyncio
from pathlib import Path

from footlight.v1 import render_pb2
from footlight_server.sessions.machine import Patience
from footlight_server.sessions.sessions import Sessions
from footlight_server.settings import Settings
from tests.server.api.service import LONG, STAGE


async def test_the_bundles_of_renders_are_in_use_until_they_end(tmp_path: Path) -> None:
    settings = Settings(
        workers=1, roots=(), scratch=tmp_path, worker_memory=0, patience=Patience(), private=True, trust_scenes=True
    )
    sessions = Sessions(settings)
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "main.usda").write_text(STAGE)
    try:
        names = ["1" * 64 + "/1", "2" * 64 + "/2"]
        specs = [
            render_pb2.RenderSpec(stage_path="main.usda", bundle=name, width=8, height=8, spp=LONG) for name in names
        ]
        first, second = (sessions.create(spec, "", tmp_path / "files") for spec in specs)
        sessions.create(render_pb2.RenderSpec(stage_path="/nowhere/main.usda"), "")
        assert sessions.bundles_in_use() == set(names)
        for session, left in ((first, set(names[1:])), (second, set())):
            sessions.cancel(session.name, keep=False)
            async with asyncio.timeout(30):
                while sessions.bundles_in_use() != left:
                    await asyncio.sleep(0.02)
    finally:
        await sessions.close()
