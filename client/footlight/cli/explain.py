"""`footlight explain`: the stage's effects, pipeline and gaps, as tables or JSON."""

import sys
from typing import Any

from rich.console import Console
from rich.table import Table

from footlight.cli.connect import connect, path_map
from footlight.cli.options import OwnConnection
from footlight.cli.report import usage
from footlight.cli.tables import write_json
from footlight.plain import plain
from footlight.spec import render_spec
from footlight.v1 import report_pb2, stage_service_pb2

# [columns] Where stdout is no terminal.
WIDTH = 160


def run_explain(connection: OwnConnection, options: dict[str, Any], *, as_json: bool) -> None:
    """Print the explanation; `options` are those of render_spec."""
    with usage():
        spec = render_spec(**options)
        spec.stage_path = path_map(connection).to_server(options["stage"])
    with connect(connection) as client:
        answer = client.explain(spec)
    if as_json:
        write_json(plain(answer))
    else:
        _print(answer)


def _print(answer: stage_service_pb2.ExplainStageResponse) -> None:
    spec, report = answer.spec, answer.report
    console = Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else WIDTH)
    time = f"time code {spec.time_code:g}" if spec.HasField("time_code") else "default time"
    console.print(f"{spec.stage_path}: {spec.width}x{spec.height}, camera {spec.camera_path or 'framed'}, {time}")
    if report.counts:
        console.print(", ".join(f"{report.counts[name]:,} {name}" for name in sorted(report.counts)))
    console.print(_effects(report))
    console.print(f"Pipeline: {' → '.join(report.pipeline)}\n")
    assumed = [(item.what, item.reason) for item in report.assumed]
    left_out = [(item.prim_path, item.what, item.reason) for item in report.left_out]
    remarks = [(item.prim_path or "stage", item.message) for item in report.remarks]
    for title, columns, rows in (
        ("Assumed", ("what", "reason"), assumed),
        ("Left out", ("prim", "what", "reason"), left_out),
        ("Remarks", ("prim", "remark"), remarks),
    ):
        console.print(_table(title, columns, rows) if rows else f"{title}: nothing")


def _effects(report: report_pb2.StageReport) -> Table:
    rows = [
        (effect.name, "yes" if effect.active else "no", effect.reason, _prims(effect))
        for effect in sorted(report.effects, key=lambda effect: not effect.active)
    ]
    return _table("Effects", ("effect", "in use", "reason", "asked for by"), rows)


def _prims(effect: report_pb2.Effect) -> str:
    more = max(effect.prim_count, len(effect.prim_paths)) - min(len(effect.prim_paths), 3)
    return "\n".join([*effect.prim_paths[:3], *([f"and {more} more"] if more > 0 else [])])


def _table(title: str, columns: tuple[str, ...], rows: list[Any]) -> Table:
    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table
