"""From a USD stage to calls on a SceneSink: the only importer of pxr."""

from footlight_server.usd.context import Admit
from footlight_server.usd.errors import (
    CameraError,
    StageError,
    StageLimitError,
    StageMalformedError,
    StageNotFoundError,
    StageUnreadableError,
)
from footlight_server.usd.open import OpenedStage, OpenLimits, open_stage
from footlight_server.usd.report import Assumption, EffectHint, LeftOut, Remark, Report
from footlight_server.usd.request import Budget, TranslateRequest
from footlight_server.usd.sink import SceneSink
from footlight_server.usd.translate import translate

__all__ = [
    "Admit",
    "Assumption",
    "Budget",
    "CameraError",
    "EffectHint",
    "LeftOut",
    "OpenLimits",
    "OpenedStage",
    "Remark",
    "Report",
    "SceneSink",
    "StageError",
    "StageLimitError",
    "StageMalformedError",
    "StageNotFoundError",
    "StageUnreadableError",
    "TranslateRequest",
    "open_stage",
    "translate",
]
