"""The command line without a server: help, options, exit codes, and what it costs to start."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from footlight.cli import exits
from footlight.cli.app import app
from footlight.cli.progress import Lines
from footlight.cli.report import duration, percent, remarks, summary
from footlight.v1 import render_pb2, report_pb2, stats_pb2

NOWHERE = "127.0.0.1:1"


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments), env={"COLUMNS": "200", "NO_COLOR": "1"})


@pytest.mark.parametrize("command", [[], ["render"], ["explain"], ["serve"]])
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
    assert set(re.findall(r"--[a-z-]+", run("serve", "--help").output)) >= {"--listen", "--workers", "--root"}


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


@pytest.mark.parametrize("command", [["render", "a.usda", "-o", "a.exr"], ["explain", "a.usda"]])
def test_no_server_is_said_with_its_address(command: list[str]) -> None:
    result = run(*command, "--server", NOWHERE)
    assert result.exit_code == exits.Exit.SERVER
    assert result.stderr.startswith(f"error: no Footlight server answers at {NOWHERE}")


@pytest.mark.parametrize("command", [["render", "a.usda", "-o", "a.exr"], ["explain", "a.usda"], ["serve"]])
def test_without_the_server_package_it_says_what_to_install(
    command: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("footlight.private.find_spec", lambda _: None)
    monkeypatch.setattr("footlight.cli.serve.find_spec", lambda _: None)
    result = run(*command)
    assert result.exit_code == exits.Exit.SERVER
    assert "pip install footlight-server" in result.stderr


def test_help_needs_neither_grpc_nor_numpy() -> None:
    program = (
        "import sys; from footlight.cli import main\n"
        "sys.argv = ['footlight', 'render', '--help']\n"
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
