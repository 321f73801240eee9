"""Stages in memory, and their translation into a capturing sink."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd

from footlight_server.usd import Admit, Report, TranslateRequest, translate
from footlight_server.usd.open import OpenedStage
from tests.server.usd.capture import CapturingSink


def stage_of(text: str) -> Any:
    """A stage from usda text without its header; a closing brace may follow on the same line."""
    layer = Sdf.Layer.CreateAnonymous("test.usda")
    layer.ImportFromString("#usda 1.0\n" + text.replace(" }", "\n}"))
    return Usd.Stage.Open(layer)


def translated(
    stage: Any, request: TranslateRequest | None = None, *, prune: str = "", **options: Any
) -> tuple[CapturingSink, Report]:
    """What the sink got, and the report."""
    sink = CapturingSink(prune=prune)
    report = translate(OpenedStage(stage, ()), sink, request or TranslateRequest(), **options)
    return sink, report


def translated_text(text: str, request: TranslateRequest | None = None, **options: Any) -> tuple[CapturingSink, Report]:
    return translated(stage_of(text), request, **options)


def reasons(report: Report) -> str:
    """All lines of what was left out."""
    return "\n".join(f"{line.path} {line.what}: {line.reason}" for line in report.left_out)


def gray_image(_path: str, _admit: Admit) -> NDArray[np.float32]:
    return np.full((2, 4, 3), 0.5, np.float32)
