"""The farm's commands without a server: what options mean, what is refused, what watching says."""

import os
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from footlight.cli.app import COMMANDS, app
from footlight.cli.board import Board
from footlight.cli.exits import Exit
from footlight.cli.job import page
from footlight.cli.report import option_of
from footlight.cli.submit import make_spec
from footlight.cli.tables import write_table
from footlight.cli.watch_view import Lines, watch_view
from footlight.cli.why import of_job, of_task
from footlight.cli.words import complaint, frames_of, size, what
from footlight.paths import PathMap
from footlight.plain import plain
from footlight.v1 import job_pb2

NOWHERE = "127.0.0.1:1"


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments), env={"COLUMNS": "200", "NO_COLOR": "1"})


def submitted(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> job_pb2.JobSpec:
    """What `footlight submit` would send, but for the place of the stage."""
    found: list[job_pb2.JobSpec] = []

    def instead(_connection: object, options: object, job: object, **_: object) -> None:
        found.append(make_spec(options, job, PathMap.of(["/here=/there"])))

    monkeypatch.setattr("footlight.cli.submit.run_submit", instead)
    result = run("submit", "/here/a.usda", *arguments)
    assert result.exit_code == 0, result.output
    return found[0]


def test_every_option_of_submit_reaches_its_field(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM_COLOUR", "blue")
    line = (
        "--frames 1001-1100x2 -o /here/out/a.####.exr --name title --show s --shot h --layer beauty "
        "--priority 0 --chunk 5 --tag a --tag b --depends 3 --depends jobs/4 --retries 0 --timeout 15m "
        "--stall-timeout 1.5s --paused --comment c --env A=b=c --env TERM_COLOUR --limit houdini --png "
        "--view Raw --camera /cam --size 64x48 --spp 3 --seed 7 --max-depth 4 --threads 2 --pixel-filter "
        "box --strategy bsdf --aov depth --aov normal --strict --split 3"
    )
    spec = submitted(monkeypatch, *line.split())
    layer_message = spec.layers[0]
    render = layer_message.render
    found, layer = plain(spec), plain(layer_message)
    del found["layers"], layer["render"]
    assert found == {
        "title": "title",
        "show": "s",
        "shot": "h",
        "priority": 0,
        "tags": ["a", "b"],
        "comment": "c",
        "depends": ["jobs/3", "jobs/4"],
        "retries": 0,
        "timeout_seconds": 900.0,
        "stall_timeout_seconds": 1.5,
        "paused": True,
        "environment": {"A": "b=c", "TERM_COLOUR": "blue"},
    }
    assert layer == {
        "name": "beauty",
        "frames": "1001-1100x2",
        "chunk": 5,
        "split": 3,
        "output": "/there/out/a.####.exr",
        "depends": [],
        "limits": ["houdini"],
    }
    assert render.png.view == "Raw"
    assert (render.width, render.height, render.spp, render.seed, render.strict) == (64, 48, 3, 7, True)
    assert not render.HasField("time_code")


def test_what_is_not_said_is_left_to_the_server(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = submitted(monkeypatch)
    assert not spec.HasField("priority")
    assert not spec.HasField("retries")
    assert [field.name for field, _ in spec.ListFields()] == ["layers"]


def test_a_relative_output_is_from_here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert submitted(monkeypatch, "-o", "a.####.exr").layers[0].output == str(tmp_path / "a.####.exr")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("submit a.usda --priority 101", "--priority"),
        ("submit a.usda --timeout soon", "'soon' is not a time; write 90s, 15m, 2h or 7d"),
        ("submit a.usda --env 1=2", "'1=2' is not NAME=VALUE"),
        ("submit a.usda --env NOT_HERE_AT_ALL", "has no value here"),
        ("submit a.usda --depends yesterday", "--depends: 'yesterday' is not a job; write 12 or jobs/12"),
        ("submit a.usda --spp 99999999999", "--spp: 99999999999 is not allowed; allowed are 0 to 4294967295"),
        ("submit a.usda --view Raw", "--png"),
        ("submit a.usda --path-map a=b", "is not FROM=TO"),
        ("submit a.usda --size 3", "WIDTHxHEIGHT"),
        ("jobs --state asleep", "'asleep' is not one of queued, running"),
        ("tasks 12 --state asleep", "'asleep' is not one of blocked, ready"),
        ("job x", "'x' is not a job; write 12 or jobs/12"),
        ("tasks x", "neither a job"),
        ("retry x", "JOB: 'x' is neither a job"),
        ("log x", "'x' is not a task"),
        ("watch 12 --tev here", "'here' is not HOST:PORT"),
        ("watch 12 --after 3", "is for --json"),
        ("watch x", "is not a job"),
        ("pause", "JOB"),
        ("skip 12", "jobs/12 alone chooses nothing"),
        ("prune", "name jobs, or --older-than TIME"),
        ("prune 12 --older-than 3d", "not both"),
        ("limits houdini", "say how many"),
        ("token revoke x", "'x' is not a token"),
        ("token create anna --scope all", "'all' is not one of"),
        ("jobs --ca /gone.pem", "/gone.pem cannot be read"),
        ("jobs --cert /gone.pem", "go together"),
    ],
)
def test_what_is_not_allowed_says_what_is(arguments: str, says: str) -> None:
    command, *rest = arguments.split()
    words = [command, rest[0], *rest[1:]] if command == "token" else [command, *rest]
    result = run(*words, "--server", NOWHERE)
    assert result.exit_code == Exit.USAGE, result.output
    assert says in " ".join(result.stderr.replace("│", " ").split())
    assert result.stdout == ""


def test_the_path_map_of_the_environment_comes_after_the_options(monkeypatch: pytest.MonkeyPatch) -> None:
    from footlight.cli.connect import path_map
    from footlight.cli.options import MappedConnection, OwnConnection

    monkeypatch.setenv("FOOTLIGHT_PATH_MAP", "/a b=/c;/d=/e")
    paths = path_map(MappedConnection("x", path_map=["/d=/f"]))
    assert [paths.to_server(path) for path in ("/a b/x", "/d/x")] == ["/c/x", "/f/x"]
    assert path_map(OwnConnection()).to_server("/d/x") == "/d/x"


def test_a_cluster_command_is_passed_on_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[list[str]] = []
    monkeypatch.setattr(os, "execv", lambda _, arguments: calls.append(arguments[1:]))
    for action in ("up", "join", "status"):
        run("cluster", action, "--help", "-x", "there", "--port=3")
    expected = [
        ["-m", "footlight_server.cluster", action, "--help", "-x", "there", "--port=3"]
        for action in ("up", "join", "status")
    ]
    assert calls == expected


def test_serve_passes_on_what_is_said_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[list[str]] = []
    monkeypatch.setattr(os, "execv", lambda _, arguments: calls.append(arguments[3:]))
    run(
        "serve",
        "--listen",
        "a:1",
        "--listen",
        "unix:b",
        "--data",
        "d",
        "--farm-workers",
        "0",
        "--trust-scenes",
        "--quota-jobs",
        "0",
    )
    assert calls == [
        [
            *("--listen=a:1", "--listen=unix:b", "--workers=1", "--log-format=text", f"--data={Path.cwd() / 'd'}"),
            *("--farm-workers=0", "--executor=local", "--trust-scenes", "--quota-jobs=0"),
        ]
    ]


def job(**fields: object) -> job_pb2.JobEvent:
    event = job_pb2.JobEvent(changed=job_pb2.Job(name="jobs/12", frames_total=5, **fields))
    event.changed.start_time.seconds = 1000
    event.time.seconds = 1030
    return event


def failure(number: int, state: int, message: str) -> job_pb2.JobEvent:
    attempt = job_pb2.Attempt(
        name=f"jobs/12/tasks/7/attempts/{number}",
        worker="h/1",
        exit_class=job_pb2.EXIT_CLASS_OUT_OF_MEMORY,
        message=message,
    )
    task = job_pb2.Task(name="jobs/12/tasks/7", layer="main", frames=[1007], state=state, last_attempt=attempt)
    return job_pb2.JobEvent(task=task)


def test_watching_says_states_failures_and_what_is_left_once(capsys: pytest.CaptureFixture[str]) -> None:
    board = Board(PathMap())
    lines = Lines(board)
    running = {"state": job_pb2.JOB_STATE_RUNNING, "tasks": job_pb2.TaskCounts(running=1, ready=2)}
    for event in (
        job(**running, frames_done=2),
        job(**running, frames_done=2),
        failure(1, job_pb2.TASK_STATE_READY, "over 2 GB"),
        failure(1, job_pb2.TASK_STATE_READY, "over 2 GB"),
        failure(2, job_pb2.TASK_STATE_FAILED, "over 2 GB"),
    ):
        lines.event(event)
    assert capsys.readouterr().err.splitlines() == [
        "jobs/12: running",
        "2 of 5 frames, 1 running, about 45 s left",
        "12/7 main 1007: out of memory: over 2 GB (h/1); will be tried again",
        "12/7 main 1007: out of memory: over 2 GB (h/1); failed",
    ]
    assert board.summary() == ""
    ended = job(state=job_pb2.JOB_STATE_FAILED, frames_done=4, tasks=job_pb2.TaskCounts(failed=1))
    ended.changed.spec.title = "shot"
    ended.changed.end_time.seconds = 1100
    board.take(ended)
    assert board.summary() == "12 shot: failed, 4 of 5 frames, 1 failed in 1:40"


def test_what_is_left_counts_what_has_begun() -> None:
    board = Board(PathMap())
    event = job(state=job_pb2.JOB_STATE_RUNNING, frames_done=1, tasks=job_pb2.TaskCounts(running=2))
    event.changed.spec.layers.add(name="main", split=2)
    board.take(event)
    assert board.remaining() == pytest.approx(30 * 4 / 1)
    task = job_pb2.Task(name="jobs/12/tasks/1", layer="main", state=job_pb2.TASK_STATE_RUNNING)
    task.progress.samples_done, task.progress.samples_total = 32, 64
    board.take(job_pb2.JobEvent(progress=task))
    assert board.remaining() == pytest.approx(30 * 3.75 / 1.25)  # half of one of two ranges
    event.changed.frames_done = 0
    board.take(event)
    assert board.remaining() is None  # too early to say


def test_what_runs_is_known_until_it_does_not() -> None:
    board = Board(PathMap.of(["/here=/there"]))
    task = job_pb2.Task(name="jobs/12/tasks/1", state=job_pb2.TASK_STATE_RUNNING)
    board.take(job_pb2.JobEvent(task=task))
    assert list(board.running) == [task.name]
    task.state = job_pb2.TASK_STATE_SUCCEEDED
    board.take(job_pb2.JobEvent(task=task))
    assert not board.running
    board.take(job_pb2.JobEvent(frame=job_pb2.Frame(path="/there/a.exr")))
    assert board.last_path == "/here/a.exr"


def test_the_table_of_a_terminal_draws_every_task_that_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    from rich.console import Console

    from footlight.cli.watch_table import ROWS, screen

    board = Board(PathMap())
    assert not screen(board).renderables
    board.take(job(state=job_pb2.JOB_STATE_RUNNING, frames_done=2, tasks=job_pb2.TaskCounts(running=ROWS + 2)))
    for number in range(1, ROWS + 3):
        attempt = job_pb2.Attempt(worker=f"host/{number}")
        task = job_pb2.Task(
            name=f"jobs/12/tasks/{number}",
            layer="main",
            frames=[number],
            state=job_pb2.TASK_STATE_RUNNING,
            last_attempt=attempt,
        )
        task.progress.samples_done, task.progress.samples_total = 3, 64
        board.take(job_pb2.JobEvent(progress=task))
    console = Console(width=120, force_terminal=False)
    with console.capture() as capture:
        console.print(screen(board))
    drawn = capture.get()
    assert [f"host/{number} " in drawn for number in (1, ROWS, ROWS + 1)] == [True, True, False]
    assert "and 2 more" in drawn
    assert "3/64 spp" in drawn
    monkeypatch.undo()


def test_a_job_on_a_page() -> None:
    spec = job_pb2.JobSpec(
        title="shot", priority=50, retries=2, layers=[job_pb2.LayerSpec(name="main", frames="1-5", chunk=2, split=1)]
    )
    spec.layers[0].render.stage_path = "/there/a.usda"
    shown = job_pb2.Job(name="jobs/12", spec=spec, state=job_pb2.JOB_STATE_RUNNING, paused=True, frames_total=5)
    shown.tasks.failed = 12
    text = "\n".join(page(shown, [failure(1, job_pb2.TASK_STATE_FAILED, "m").task], PathMap.of(["/here=/there"])))
    for says in (
        "jobs/12: shot",
        "running, paused",
        "/here/a.usda",
        "tasks of 2 frames",
        "out of memory: m",
        "and 11 more",
    ):
        assert says in text
    assert "comment" not in text


def test_what_waits_for_nothing_is_told_by_its_state() -> None:
    running = job_pb2.Job(name="jobs/12", state=job_pb2.JOB_STATE_RUNNING, tasks=job_pb2.TaskCounts(running=2, ready=1))
    assert of_job(running) == "jobs/12 is running: 1 ready, 2 running"
    failed = job_pb2.Job(name="jobs/12", state=job_pb2.JOB_STATE_FAILED, tasks=job_pb2.TaskCounts(failed=1))
    assert of_job(failed) == "jobs/12 has ended: failed; `footlight job 12` shows what failed"
    task = job_pb2.Task(name="jobs/12/tasks/7", state=job_pb2.TASK_STATE_FAILED)
    task.last_attempt.exit_class, task.last_attempt.message = job_pb2.EXIT_CLASS_SCENE, "no camera"
    assert of_task(task) == (
        "jobs/12/tasks/7 has failed: scene: no camera; `footlight retry 12/7` gives it another round"
    )
    task.state = job_pb2.TASK_STATE_SKIPPED
    assert of_task(task) == "jobs/12/tasks/7 has ended: skipped"


@pytest.mark.parametrize("command", ["", *(each.__name__ for group in COMMANDS.values() for each in group)])
def test_help_shows_no_type_behind_a_flag(command: str) -> None:
    shown = run(*filter(None, (command, "--help"))).stdout
    assert "--help" in shown
    assert "bool" not in shown


def test_a_table_gives_way_where_there_is_little_room(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    columns, row = ("TITLE", "SHOW", "STATE", "REMARK"), ("a title that is long", "", "succeeded", "one two three four")
    write_table(columns, [row], cut=("TITLE",), fold=("REMARK",))
    whole = capsys.readouterr().out.splitlines()
    assert whole[1].split() == [word for cell in row for word in cell.split()]
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "34")
    write_table(columns, [row], cut=("TITLE",), fold=("REMARK",))
    lines = capsys.readouterr().out.splitlines()
    assert "SHOW" not in lines[0]
    assert "…" in lines[1]
    assert "succeeded" in lines[1]
    words = row[3].split()
    assert [word for line in lines for word in line.split() if word in words] == words


def test_the_end_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    ended = job(state=job_pb2.JOB_STATE_SUCCEEDED)
    with watch_view(Board(PathMap()), as_json=False) as view:
        view.event(ended)
    assert len(capsys.readouterr().err.splitlines()) == 2  # the state, and what came of it


def test_words_are_short() -> None:
    task = job_pb2.Task(name="jobs/12/tasks/7", layer="main", frames=range(1, 9), sample_begin=0, sample_end=16)
    assert frames_of(task) == "1…8 (8)"
    assert what(task, spp=64) == "12/7 main 1…8 (8) samples 0-16"
    assert what(task, spp=16) == "12/7 main 1…8 (8)"
    task.kind = job_pb2.TASK_KIND_MERGE
    assert what(task) == "12/7 main 1…8 (8) merge"
    attempt = job_pb2.Attempt(exit_class=job_pb2.EXIT_CLASS_SCENE, message="no camera", prim_path="/World")
    assert complaint(attempt) == "scene: /World: no camera"
    assert [size(number) for number in (0, 999, 1000, 12_345_678, 10**12)] == [
        "0 B",
        "999 B",
        "1.0 KB",
        "12 MB",
        "1.0 TB",
    ]


def test_fields_at_fault_are_said_as_options() -> None:
    for field, option in {
        "spec.title": "--name",
        "spec.layers[0].frames": "--frames",
        "spec.layers[0].name": "--layer",
        "spec.layers[2].render.spp": "--spp",
        "spec.layers[0].render.png.view": "--view",
        "spec.layers[0].render.stage_path": "STAGE",
        "spec.environment[LD_PRELOAD]": "--env",
        "spec.aovs[1]": "--aov",
        "spec.depends[0]": "--depends",
        "selection.frames": "--frames",
        "job": "JOB",
    }.items():
        assert option_of(field) == option, field


def test_times_are_plain_text() -> None:
    event = job()
    event.time.nanos = 500_000_000
    assert plain(event)["time"] == "1970-01-01T00:17:10.500Z"
    assert plain(event.changed)["end_time"] is None


def test_other_peoples_words_do_not_steer_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    from footlight.cli.report import note

    note("a\x1b]0;owned\x07b\nc ü")
    write_table(("TITLE",), [("\x1b[31mred",)])
    written, said = capsys.readouterr()
    assert said == "a\N{REPLACEMENT CHARACTER}]0;owned\N{REPLACEMENT CHARACTER}b\nc ü\n"
    assert "\x1b" not in written
