"""The log of an attempt: in order, with times, and no harm done where it cannot be written."""

import asyncio
import re
from pathlib import Path

from footlight_server.farm.logs import LogWriter


async def test_lines_come_in_order_each_with_its_time(tmp_path: Path) -> None:
    times = iter(range(1_700_000_000, 1_700_001_000))
    writer = LogWriter(lambda: float(next(times)))
    log, other = writer.open(tmp_path / "jobs" / "1" / "1-1.log"), writer.open(tmp_path / "1-2.log")
    for number in range(200):
        log.say(f"line {number}")
        other.say("two\nlines")
    await log.flush()
    lines = (tmp_path / "jobs" / "1" / "1-1.log").read_text().splitlines()
    assert [line.split(" ", 1)[1] for line in lines] == [f"line {number}" for number in range(200)]
    assert all(re.match(r"2023-11-14T22:\d\d:\d\d\.000Z line", line) for line in lines)
    assert [line.split(" ")[0] for line in lines] == sorted(line.split(" ")[0] for line in lines)
    assert len((tmp_path / "1-2.log").read_text().splitlines()) == 400
    writer.close()


async def test_a_log_that_cannot_be_written_stops_nobody(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    writer = LogWriter(lambda: 0.0)
    log = writer.open(tmp_path / "file" / "1-1.log")
    log.say("lost")
    async with asyncio.timeout(5):
        await log.flush()
    writer.close()
    assert (tmp_path / "file").read_text() == "in the way"
