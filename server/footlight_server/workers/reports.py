"""From the reports of translator and core to the protocol's."""

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

from footlight.v1 import report_pb2
from footlight_server.usd import Report
from footlight_server.workers.causes import TaskFailedError
from footlight_server.workers.failure import Failure, FailureReason

# Prims that are named for each effect; all are counted.
_NAMED_PRIMS = 16


class Pipeline(Protocol):
    """The part of the core's Renderer that is needed here."""

    effects: list[dict[str, Any]]
    pipeline: list[str]
    left_out: list[tuple[str, str]]


def effects_of(renderer: Pipeline, report: Report) -> list[report_pb2.Effect]:
    """The core's effects, and those that the translation itself applied."""
    applied = {hint.name: hint for hint in report.effects}
    effects = [
        _effect(known["name"], known["reason"], known["paths"], active=known["active"])
        for known in renderer.effects
        if known["name"] not in applied
    ]
    return effects + [_effect(hint.name, hint.reason, hint.paths, active=True) for hint in applied.values()]


def stage_report(report: Report, renderer: Pipeline) -> report_pb2.StageReport:
    """All that is known about a stage."""
    message = report_pb2.StageReport(effects=effects_of(renderer, report), pipeline=renderer.pipeline)
    for line in report.left_out:
        message.left_out.add(prim_path=line.path, what=line.what, reason=line.reason)
    for path, reason in renderer.left_out:
        message.left_out.add(prim_path=path, what="light or geometry", reason=reason)
    for assumption in report.assumed:
        message.assumed.add(what=assumption.what, reason=assumption.reason)
    for remark in report.notes:
        message.remarks.add(prim_path=remark.path, message=remark.message)
    _fill(message.counts, report.counts)
    return message


def refuse_left_out(report: report_pb2.StageReport) -> None:
    """Raises TaskFailedError if anything was left out."""
    if report.left_out:
        first = report.left_out[0]
        more = f" (and {len(report.left_out) - 1} more)" if len(report.left_out) > 1 else ""
        message = f"strict: {first.prim_path} {first.what} would be left out: {first.reason}{more}"
        raise TaskFailedError(Failure(FailureReason.SCENE, message, first.prim_path))


def _effect(name: str, reason: str, paths: Iterable[str], *, active: bool) -> report_pb2.Effect:
    paths = list(paths)
    return report_pb2.Effect(
        name=name, active=active, reason=reason, prim_paths=paths[:_NAMED_PRIMS], prim_count=len(paths)
    )


def _fill(target: Any, counts: Mapping[str, int]) -> None:
    for name, count in counts.items():
        target[name] = count
