"""The command line without a server: help, options, exit codes, and what it costs to start."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.core import TyperGroup
from typer.main import get_command
from typer.testing import CliRunner, Result

from footlight.cli import exits
from footlight.cli.app import app
from footlight.cli.progress import Lines
from footlight.cli.report import duration, percent, remarks, summary
from footlight.v1 import render_pb2, report_pb2, stats_pb2
from footlight_server.options import parse_arguments

NOWHERE = "127.0.0.1:1"


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments), env={"COLUMNS": "200", "NO_COLOR": "1"})


def all_commands() -> list[list[str]]:
    """Every command, by what one types."""
    group = get_command(app)
    assert isinstance(group, TyperGroup)
    found: list[list[str]] = [[]]
    for name, command in group.commands.items():
        deeper = [[name, below] for below in command.commands] if isinstance(command, TyperGroup) else []
        found += [[name], *deeper]
    return [command for command in found if command[:1] != ["cluster"] or len(command) < 2]


@pytest.mark.parametrize("command", all_commands(), ids=" ".join)
def test_help_says_what_and_lists_the_exit_codes(command: list[str]) -> None:
    text = " ".join(run(*command, "--help").output.split())
    for code, meaning in exits.HELP.items():
        assert f"{code.value} {meaning}" in text


def test_every_option_of_the_manual_is_there() -> None:
    options = set(re.findall(r"--[a-z-]+", run("render", "--help").output))
    assert options >= {
        *("--output", "--server", "--camera", "--frame", "--size", "--spp", "--seed", "--max-depth", "--threads"),
        *("--pixel-filter", "--strategy", "--aov", "--strict", "--stats", "--png", "--view", "--keep-partial"),
    }
    for command, needs in MANUAL.items():
        assert set(re.findall(r"--[a-z-]+", run(command, "--help").output)) >= options_of(needs), command


def test_a_job_takes_every_option_of_a_render() -> None:
    of_one_image = {"--frame", "--stats", "--keep-partial"}
    render, submit = (set(re.findall(r"--[a-z-]+", run(name, "--help").output)) for name in ("render", "submit"))
    assert render - submit == of_one_image


def test_the_server_takes_every_option_that_is_passed_on() -> None:
    values = {"--executor": "local", "--log-format": "json", "--listen": "unix:/a", "--root": "/", "--output-root": "/"}
    switches = {"--trust-scenes"}
    offered = set(re.findall(r"--[a-z-]+", run("serve", "--help").output)) - {"--help", "--tls-cert"}
    given = [option if option in switches else f"{option}={values.get(option, 1)}" for option in sorted(offered)]
    parsed = vars(parse_arguments(given))
    assert {option.removeprefix("--").replace("-", "_") for option in offered} <= set(parsed)
    own = {"private", "verbose", "tls_cert"}
    assert set(parsed) - own == {option.removeprefix("--").replace("-", "_") for option in offered}


def options_of(text: str) -> set[str]:
    return {f"--{name}" for name in text.split()}


# What the manual promises.
MANUAL = {
    "submit": "frames output name show shot layer priority chunk split tag depends retries timeout stall-timeout "
    "paused dry-run watch upload env path-map comment limit png server token ca json",
    "jobs": "state user show shot tag count json",
    "tasks": "state layer count json",
    "log": "follow json",
    "watch": "tev json",
    "retry": "layer frames json",
    "skip": "layer frames all json",
    "prune": "older-than dry-run json",
    "fetch": "output format layer frame json",
    "serve": "listen tls-cert tls-key tls-client-ca data database workers farm-workers root output-root allow-env "
    "trust-scenes quota-jobs quota-tasks quota-bytes keep-blobs max-prims max-instances max-points max-texels metrics "
    "log-format executor ray-address drain-seconds",
}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--size", "12"], "WIDTHxHEIGHT"),
        (["--size", "0x4"], "WIDTHxHEIGHT"),
        (["--size", "-3x4"], "WIDTHxHEIGHT"),
        (["--spp", "0"], "--spp"),
        (["--seed", "-1"], "--seed"),
        (["--seed", "4294967296"], "4294967296 is not allowed"),
        (["--pixel-filter", "sinc"], "blackman-harris"),
        (["--strategy", "luck"], "bsdf"),
        (["--view", "Raw"], "--png"),
        (["--png", "a.jpg"], "has to end in .png"),
        (["--stats", "a.txt"], "has to end in .json"),
        (["-o", "a.tif"], "has to end in .exr"),
        (["--unheard-of"], "--unheard-of"),
    ],
)
def test_options_that_are_not_allowed_say_what_is(tmp_path: Path, arguments: list[str], says: str) -> None:
    result = run("render", "a.usda", "-o", str(tmp_path / "a.exr"), "--server", NOWHERE, *arguments)
    assert result.exit_code == exits.Exit.USAGE
    assert says in result.stderr
    assert result.stdout == ""


def test_an_output_that_cannot_be_written_is_found_before_the_render(tmp_path: Path) -> None:
    (tmp_path / "folder.exr").mkdir()
    for name, says in (("gone/a.exr", "is not a directory"), ("folder.exr", "is a directory")):
        result = run("render", "a.usda", "-o", str(tmp_path / name), "--server", NOWHERE)
        assert result.exit_code == exits.Exit.OUTPUT
        assert str(tmp_path / name) in result.stderr
        assert says in result.stderr


@pytest.mark.parametrize(
    "command",
    [
        ["render", "a.usda", "-o", "a.exr"],
        ["explain", "a.usda"],
        ["submit", "a.usda"],
        ["jobs"],
        ["watch", "12"],
        ["retry", "12/3"],
        ["token", "list"],
    ],
    ids=" ".join,
)
def test_no_server_is_said_with_its_address(command: list[str]) -> None:
    result = run(*command, "--server", NOWHERE)
    assert result.exit_code == exits.Exit.SERVER
    assert result.stderr.startswith(f"error: no Footlight server answers at {NOWHERE}")


@pytest.mark.parametrize(
    "command", [["render", "a.usda", "-o", "a.exr"], ["explain", "a.usda"], ["serve"], ["cluster", "up"]]
)
def test_without_the_server_package_it_says_what_to_install(
    command: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("footlight.private.find_spec", lambda _: None)
    monkeypatch.setattr("footlight.cli.serve.find_spec", lambda _: None)
    monkeypatch.setattr("footlight.cli.cluster.find_spec", lambda _: None)
    result = run(*command)
    assert result.exit_code == exits.Exit.SERVER
    assert re.search("pip install '?footlight-server", result.stderr)


@pytest.mark.parametrize("command", ["render", "submit", "watch"])
def test_help_needs_neither_grpc_nor_numpy(command: str) -> None:
    program = (
        "import sys; from footlight.cli import main\n"
        f"sys.argv = ['footlight', '{command}', '--help']\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print(sorted({'grpc', 'numpy', 'google.protobuf', 'zstandard'} & set(sys.modules)), file=sys.stderr)"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stderr.strip() == "[]"


def test_remarks_are_shortened_and_say_where_the_rest_is() -> None:
    report = report_pb2.StageReport(
        assumed=[report_pb2.Assumption(what="a dome", reason="no light")],
        left_out=[report_pb2.LeftOut(prim_path=f"/p{k}", what="BasisCurves", reason="not yet") for k in range(9)],
    )
    lines = remarks(report)
    assert lines[0] == "assumed: a dome: no light"
    assert lines[1] == "left out: /p0: BasisCurves: not yet"
    assert lines[-1] == "… and 4 more; `footlight explain` lists them"


def test_the_summary_puts_a_price_on_accuracy() -> None:
    stats = stats_pb2.RenderStats(spp=16, error_mean=0.02, seconds=stats_pb2.StageSeconds(render=4, total=5))
    render = render_pb2.Render(stats=stats, spec=render_pb2.RenderSpec(width=64, height=32))
    assert summary("a.exr", render) == "a.exr: 64x32, 16 spp, 5.0 s; error 2 %, half of that for 12 s more"
    stats.guards["bad_radiance"] = 3
    assert "3 samples met a guard" in summary("a.exr", render_pb2.Render(stats=stats))


def test_percentages_keep_two_digits() -> None:
    assert [percent(x) for x in (0.12, 0.0123, 0.00123, 1.5)] == ["12 %", "1.2 %", "0.12 %", "150 %"]


def test_durations_are_read_at_a_glance() -> None:
    assert [duration(x) for x in (1.23, 9.96, 99.4, 99.6, 3599.6, 3723)] == [
        "1.2 s",
        "10 s",
        "99 s",
        "1:40",
        "1:00:00",
        "1:02:03",
    ]


def test_plain_lines_for_pipes(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("footlight.cli.progress.LINE_INTERVAL", 0.0)
    lines = Lines()
    lines.state(render_pb2.Render(state=render_pb2.RENDER_STATE_RENDERING))
    lines.progress(render_pb2.Progress(samples_done=8, samples_total=64, error_mean=0.1, seconds_remaining=7))
    assert capsys.readouterr() == ("", "rendering\nrendering 8/64 spp, error 10 %, 7.0 s left\n")
