"""The farm from the command line: what one types, what comes out, which exit code; with a real server."""

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest
from typer.testing import CliRunner

from footlight.cli.app import app
from footlight.cli.exits import Exit
from tests.client.tev_receiver import tev_receiver
from tests.e2e.conftest import FOOTLIGHT
from tests.e2e.farm_server import FarmServer, farm_server

SMALL = ("--size", "32x32", "--spp", 2, "--threads", 1)
# More than any test waits for.
ENDLESS = ("--size", "32x32", "--spp", 1 << 20, "--threads", 1)

Run = Callable[..., subprocess.CompletedProcess[str]]
ReadExr = Callable[[Path], tuple[oiio.ImageSpec, dict[str, np.ndarray]]]


@pytest.fixture(scope="module")
def farm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FarmServer]:
    with farm_server(
        tmp_path_factory.mktemp("farm"), "--farm-workers", 2, "--drain-seconds", 0, "--allow-env", "STUDIO"
    ) as server:
        yield server
        assert server.stop() == 0


def environment(server: FarmServer) -> dict[str, str]:
    return {"FOOTLIGHT_SERVER": server.address, "COLUMNS": "200", "NO_COLOR": "1"}


@pytest.fixture
def run(farm: FarmServer) -> Run:
    """Runs the command line in this process: starting one for each command would take most of the time."""

    def call(*arguments: object) -> subprocess.CompletedProcess[str]:
        done = CliRunner().invoke(app, list(map(str, arguments)), env=environment(farm))
        return subprocess.CompletedProcess(arguments, done.exit_code, done.stdout, done.stderr)

    return call


def answer(run: Run, *arguments: object) -> Any:
    """What a command says with --json."""
    done = run(*arguments, "--json")
    assert done.returncode == Exit.OK, done.stderr
    return json.loads(done.stdout)


def submit(run: Run, *arguments: object) -> str:
    done = run("submit", *arguments)
    assert done.returncode == Exit.OK, done.stderr
    return done.stdout.strip()


def wait_until(what: Callable[[], bool], seconds: float = 30) -> None:
    deadline = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def state(run: Run, job: str) -> str:
    word: str = answer(run, "job", job)["state"]
    return word.removeprefix("JOB_STATE_").lower()


@pytest.fixture
def waiting(run: Run, room: Path) -> Iterator[str]:
    """A paused job of three frames."""
    job = submit(run, room, "--frames", "1-3", "--paused", *SMALL)
    yield job
    run("cancel", job)


def test_submit_watch_fetch(run: Run, room: Path, tmp_path: Path, read_exr: ReadExr) -> None:
    done = run("submit", room, "--frames", "1-5x2", "--watch", "--name", "three", *SMALL)
    assert done.returncode == Exit.OK, done.stderr
    job = done.stdout.strip()
    assert re.fullmatch(r"jobs/\d+", job)
    assert "frames: 1-5x2" in done.stderr
    assert f"{job.partition('/')[2]} three: succeeded, 3 of 3 frames in" in done.stderr
    (tmp_path / "out").mkdir()
    fetched = run("fetch", job, "-o", tmp_path / "out")
    assert fetched.returncode == Exit.OK, fetched.stderr
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["main.0001.exr", "main.0003.exr", "main.0005.exr"]
    _, channels = read_exr(tmp_path / "out" / "main.0003.exr")
    assert channels["G"].mean() > 0.01
    again = run("fetch", job, "-o", tmp_path / "out")
    assert "0 files fetched, 3 here already" in again.stderr
    (tmp_path / "out" / "main.0003.exr").write_bytes(b"half an image")
    assert "1 file fetched, 2 here already" in run("fetch", job, "-o", tmp_path / "out").stderr
    assert "it has main" in run("fetch", job, "--layer", "beauty").stderr
    assert "for a new directory write" in run("fetch", job, "-o", tmp_path / "new").stderr
    single = run("render", room, "--frame", 3, "-o", tmp_path / "one.exr", *SMALL)
    assert single.returncode == Exit.OK, single.stderr
    assert (tmp_path / "one.exr").read_bytes() == (tmp_path / "out" / "main.0003.exr").read_bytes()


def test_pictures_come_with_the_frames(run: Run, room: Path, tmp_path: Path) -> None:
    job = submit(run, room, "--frames", "7-8", "--png", "--watch", *SMALL)
    for kind, name, size in (
        ("png", "a.####.png", (32, 32)),
        ("thumbnail", "<layer>.$F4.png", (32, 32)),
        ("contact-sheet", "sheet.png", None),
    ):
        files = answer(run, "fetch", job, "--format", kind, "-o", tmp_path / kind / name)
        assert len(files) == (1 if kind == "contact-sheet" else 2)
        for file in files:
            image = oiio.ImageInput.open(file["path"])
            assert image is not None, oiio.geterror()
            assert size in (None, (image.spec().width, image.spec().height))
    assert (tmp_path / "thumbnail" / "main.0007.png").exists()


def test_images_at_an_output_path_are_there(run: Run, room: Path, tmp_path: Path, farm: FarmServer) -> None:
    mapped = ("--path-map", f"/studio={tmp_path}", "--path-map", f"/stages={room.parent}")
    submitted = run(
        "submit", "/stages/room.usda", "--frames", "9", "-o", "/studio/a.####.exr", *mapped, "--watch", *SMALL
    )
    assert submitted.returncode == Exit.OK, submitted.stderr
    assert (tmp_path / "a.0009.exr").exists()
    job = submitted.stdout.strip()
    assert str(tmp_path / "a.####.exr") in run("job", job).stdout
    shown = run("job", job, *mapped).stdout
    assert "/studio/a.####.exr" in shown
    assert "/stages/room.usda" in shown
    assert str(farm.data) not in shown


def test_a_dry_run_says_what_would_come_and_makes_nothing(run: Run, room: Path) -> None:
    before = len(answer(run, "jobs", "--count", 1000))
    done = run("submit", room, "--frames", "1-100:4", "--chunk", 10, "--dry-run", *SMALL)
    assert done.returncode == Exit.OK
    assert "tasks: 10" in done.stdout
    assert "interleaved" in done.stdout
    found = answer(run, "submit", room, "--frames", "1-4", "--split", 2, "--dry-run", *SMALL)
    assert found["job"]["name"] == ""
    assert found["job"]["spec"]["priority"] == 50
    assert len(answer(run, "jobs", "--count", 1000)) == before


def test_a_job_that_fails_says_why_and_succeeds_when_it_is_mended(run: Run, room: Path, tmp_path: Path) -> None:
    stage = tmp_path / "shot.usda"
    stage.write_text(room.read_text().replace('def Camera "Camera"', 'def Camera "Other"'))
    failed = run("submit", stage, "--camera", "/World/Camera", "--frames", "1-2", "--watch", *SMALL)
    job = failed.stdout.strip()
    number = job.partition("/")[2]
    assert failed.returncode == Exit.FAILED
    assert "scene: /World/Camera" in failed.stderr
    assert "2 failed" in failed.stderr
    assert run("watch", job).returncode == Exit.FAILED
    assert "scene: /World/Camera" in run("job", job).stdout
    tasks = answer(run, "tasks", job, "--state", "failed")
    assert [task["last_attempt"]["exit_class"] for task in tasks] == ["EXIT_CLASS_SCENE"] * 2
    assert "/World/Camera" in run("log", f"{number}/1").stdout
    assert "several tasks" in " ".join(run("log", job).stderr.split())
    stage.write_text(room.read_text())
    assert answer(run, "retry", f"{number}/1") == [{"job": job, "changed": 1}]
    wait_until(lambda: state(run, job) == "failed")  # the other one still has
    assert run("retry", job).stdout == f"{job}: 1 task to be tried again\n"
    assert run("watch", job).returncode == Exit.OK
    attempts = answer(run, "tasks", f"{number}/1")
    assert [attempt["exit_class"] for attempt in attempts] == ["EXIT_CLASS_SCENE", "EXIT_CLASS_SUCCEEDED"]
    assert "succeeded" in run("tasks", f"{number}/1").stdout


def test_pause_why_resume(run: Run, waiting: str) -> None:
    assert "paused" in run("why", waiting).stdout
    assert answer(run, "why", f"{waiting}/tasks/1")["reasons"]
    assert answer(run, "resume", waiting)[0]["paused"] is False
    assert run("watch", waiting).returncode == Exit.OK
    assert answer(run, "why", waiting)["reasons"] == []
    assert f"{waiting} has ended: succeeded" in run("why", waiting).stderr
    assert f"{waiting}/tasks/2 has ended: succeeded" in run("why", f"{waiting}/tasks/2").stderr
    assert run("pause", waiting).returncode == Exit.STATE


def test_cancel(run: Run, waiting: str) -> None:
    assert run("prune", waiting).returncode == Exit.STATE
    assert run("cancel", waiting).returncode == Exit.OK
    done = run("watch", waiting)
    assert done.returncode == Exit.CANCELLED
    assert "cancelled" in done.stderr
    assert run("cancel", waiting).returncode == Exit.OK  # nothing to do


def test_what_was_done_before_a_refusal_is_said(run: Run, waiting: str) -> None:
    done = run("cancel", waiting, "jobs/999999")
    assert done.returncode == Exit.NOT_FOUND
    assert done.stdout == f"{waiting}: cancelled\n"
    done = run("retry", waiting, "jobs/999999")
    assert done.returncode == Exit.NOT_FOUND
    assert done.stdout == f"{waiting}: 3 tasks to be tried again\n"
    run("cancel", waiting)


def test_skip(run: Run, waiting: str) -> None:
    assert answer(run, "skip", waiting, "--frames", "1-2") == [{"job": waiting, "changed": 2}]
    assert run("skip", waiting, "--all").stdout == f"{waiting}: 1 task skipped\n"
    assert run("watch", waiting).returncode == Exit.OK
    assert [task["state"] for task in answer(run, "tasks", waiting)] == ["TASK_STATE_SKIPPED"] * 3


def test_jobs_are_found_by_what_they_are(run: Run, room: Path) -> None:
    job = submit(run, room, "--show", "moon", "--shot", "010", "--tag", "hero", "--paused", *SMALL)
    for choice in (("--show", "moon"), ("--shot", "010"), ("--tag", "hero")):
        assert [found["name"] for found in answer(run, "jobs", *choice)] == [job]
    assert job in [found["name"] for found in answer(run, "jobs", "--state", "queued", "--state", "running")]
    assert answer(run, "jobs", "--state", "cancelled", "--show", "moon") == []
    line = run("jobs", "--show", "moon").stdout.splitlines()[1].split()
    assert line[:5] == [job.partition("/")[2], "paused", "room.usda", "moon", "010"]
    run("cancel", job)


def test_prune_forgets(run: Run, waiting: str) -> None:
    run("cancel", waiting)
    assert answer(run, "prune", waiting, "--dry-run")["jobs"] == [waiting]
    assert run("prune", waiting, "--dry-run").stderr == "1 job would be pruned\n"
    assert run("prune", waiting).stdout == f"{waiting}\n"
    assert run("job", waiting).returncode == Exit.NOT_FOUND
    assert answer(run, "prune", "--older-than", "1d")["jobs"] == []


def test_limits_workers_tokens(run: Run) -> None:
    assert answer(run, "limits", "houdini", 3, "--per", "host")[0]["unit"] == "LIMIT_UNIT_HOST"
    # What a limit counts stays until something else is said.
    assert answer(run, "limits", "houdini", 2)[0] == {
        "name": "houdini",
        "most": 2,
        "unit": "LIMIT_UNIT_HOST",
        "running": 0,
    }
    assert answer(run, "limits", "disk", 2)[0]["unit"] == "LIMIT_UNIT_TASK"
    assert "houdini" in run("limits").stdout
    assert len(answer(run, "workers")) == 2
    made = answer(run, "token", "create", "anna", "--scope", "read", "--expires", "1h", "--comment", "laptop")
    assert made["secret"].startswith("footlight_")
    assert made["secret"] not in run("token", "list").stdout
    name = made["token"]["name"]
    assert run("token", "revoke", name).stdout == f"{name} of anna: revoked\n"
    assert [token["revoke_time"] is None for token in answer(run, "token", "list")] == [False]


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        ("submit {room} --frames 1-", Exit.USAGE, "--frames"),
        ("submit {room} --frames 1-2 -o /tmp/a.exr", Exit.USAGE, "--output"),
        ("submit {room} --env LD_PRELOAD=x", Exit.USAGE, "--env: 'LD_PRELOAD': not allowed"),
        ("submit {room} --spp 2000000", Exit.USAGE, "--spp"),
        ("submit {room} --depends 999999", Exit.USAGE, "999999"),
        ("submit /gone/a.usda", Exit.STAGE, "/gone/a.usda"),
        ("job 999999", Exit.NOT_FOUND, "jobs/999999"),
        ("watch 999999", Exit.NOT_FOUND, "jobs/999999"),
        ("log 999999/1", Exit.NOT_FOUND, "999999"),
        ("fetch 999999", Exit.NOT_FOUND, "999999"),
        ("jobs --server unix:/gone/socket", Exit.SERVER, "no Footlight server answers at unix:/gone/socket"),
        ("token revoke 999999", Exit.NOT_FOUND, "999999"),
        ("jobs --server 127.0.0.1:1", Exit.SERVER, "no Footlight server answers at 127.0.0.1:1: Connection refused"),
    ],
)
def test_refusals_have_a_code_and_name_what_is_wrong(
    run: Run, room: Path, arguments: str, code: Exit, says: str
) -> None:
    done = run(*arguments.format(room=room).split())
    assert done.returncode == code, done.stderr
    assert says in done.stderr
    assert done.stdout == ""


def test_variables_reach_the_server(run: Run, room: Path) -> None:
    found = answer(run, "submit", room, "--env", "STUDIO=moon", "--dry-run", *SMALL)
    assert found["job"]["spec"]["environment"] == {"STUDIO": "moon"}


def test_a_log_is_followed_to_its_end(run: Run, room: Path) -> None:
    job = submit(run, room, *SMALL)
    number = job.partition("/")[2]
    wait_until(lambda: answer(run, "tasks", job)[0]["attempts"] > 0)
    followed = run("log", f"{number}/1", "--follow")
    assert followed.returncode == Exit.OK
    assert "ended: succeeded" in followed.stdout
    text = "".join(json.loads(line)["text"] for line in run("log", job, "--json").stdout.splitlines())
    assert text == followed.stdout == run("log", f"{number}/1/1").stdout


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_leaves_the_job_running(farm: FarmServer, run: Run, room: Path, number: signal.Signals) -> None:
    command = [FOOTLIGHT, "submit", room, "--watch", *ENDLESS]
    with subprocess.Popen(
        list(map(str, command)),
        env=os.environ | environment(farm),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as watching:
        assert watching.stdout is not None
        job = watching.stdout.readline().strip()
        try:
            wait_until(lambda: state(run, job) == "running")
            watching.send_signal(number)
            _, said = watching.communicate(timeout=20)
        finally:
            watching.kill()
    assert watching.returncode == Exit.CANCELLED
    assert f"the job goes on, and `footlight watch {job.partition('/')[2]}` comes back to it" in said
    assert state(run, job) == "running"
    run("cancel", job)
    assert run("watch", job).returncode == Exit.CANCELLED


def test_tev_shows_the_frames_as_they_converge(run: Run, room: Path, tmp_path: Path, read_exr: ReadExr) -> None:
    with tev_receiver() as receiver:
        job = submit(run, room, "--frames", "1001-1002", "--size", "96x80", "--spp", 400, "--threads", 1)
        done = run("watch", job, "--tev", f"127.0.0.1:{receiver.port}")
        assert done.returncode == Exit.OK, done.stderr
    assert receiver.faults == []
    number = job.partition("/")[2]
    assert set(receiver.images) == {f"{number} main 1001", f"{number} main 1002"}
    answer(run, "fetch", job, "-o", tmp_path / "a.####.exr")
    for frame in (1001, 1002):
        _, channels = read_exr(tmp_path / f"a.{frame}.exr")
        color = np.stack([channels[name] for name in "RGB"], axis=2)
        # Half precision: 11 bits of significand, wrong by half of the last.
        np.testing.assert_allclose(receiver.images[f"{number} main {frame}"], color, rtol=2.0**-11, atol=2.0**-24)


def test_a_viewer_that_is_not_there_is_said_once_and_does_no_harm(run: Run, room: Path) -> None:
    job = submit(run, room, "--frames", "1-2", "--size", "64x64", "--spp", 200, "--threads", 1)
    done = run("watch", job, "--tev", "127.0.0.1:1")
    assert done.returncode == Exit.OK, done.stderr
    assert done.stderr.count("no viewer at 127.0.0.1:1: Connect") == 1


def test_an_uploaded_stage(run: Run, room: Path, tmp_path: Path) -> None:
    stage = tmp_path / "mine.usda"
    stage.write_text(room.read_text())
    job = submit(run, stage, "--upload", "--frames", "1", "--paused", *SMALL)
    stage.unlink()
    run("resume", job)
    done = run("watch", job)
    assert done.returncode == Exit.OK, done.stderr
    assert answer(run, "job", job)["spec"]["layers"][0]["render"]["bundle"]
