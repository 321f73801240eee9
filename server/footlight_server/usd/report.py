"""What a translation did: what was assumed, what was left out and why, and how much there is."""

from collections import Counter
from dataclasses import dataclass, field

MAX_LINES = 1000  # per list; the rest is counted


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Something the stage holds and the image does not."""

    path: str
    what: str
    reason: str


@dataclass(frozen=True, slots=True)
class Assumption:
    """Something the stage does not say."""

    what: str
    reason: str


@dataclass(frozen=True, slots=True)
class Remark:
    """Something worth knowing; path is empty if it concerns the whole stage."""

    path: str
    message: str


@dataclass(frozen=True, slots=True)
class EffectHint:
    """An effect that the translation itself applied, and the prims that asked for it."""

    name: str
    reason: str
    paths: tuple[str, ...]


@dataclass(slots=True)
class Report:
    """The result of a translation.

    Attributes:
        camera: path of the camera used; empty for the framed camera.
        settings: path of the RenderSettings used; empty if none.
        width, height: [pixels]
        time_code: at which everything was read.
        up_axis: "Y" or "Z".
        meters_per_unit: [m per stage unit]
        purposes: of the prims rendered.
        counts: prims, meshes, points, triangles, instances, lights, materials; those of a prototype once.
    """

    camera: str = ""
    settings: str = ""
    width: int = 0
    height: int = 0
    time_code: float = 0.0
    up_axis: str = "Y"
    meters_per_unit: float = 0.01
    purposes: tuple[str, ...] = ()
    left_out: list[LeftOut] = field(default_factory=list)
    assumed: list[Assumption] = field(default_factory=list)
    notes: list[Remark] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    effects: list[EffectHint] = field(default_factory=list)
    lines_dropped: int = 0

    def leave_out(self, path: object, what: str, reason: str) -> None:
        """One line: what is not in the image, and why."""
        line = LeftOut(str(path), what, reason)
        if len(self.left_out) >= MAX_LINES:
            self.lines_dropped += 1
        else:
            self.left_out.append(line)

    def assume(self, what: str, reason: str) -> None:
        """One line: what the stage does not say; the same line only once."""
        line = Assumption(what, reason)
        if line not in self.assumed:
            self.assumed.append(line)

    def note(self, path: object, message: str) -> None:
        """One line that is neither left out nor assumed."""
        if len(self.notes) >= MAX_LINES:
            self.lines_dropped += 1
        else:
            self.notes.append(Remark(str(path), message))

    def finish(self) -> None:
        """Says how many lines did not fit."""
        if self.lines_dropped > 0:
            self.notes.append(Remark("", f"{self.lines_dropped} more lines of this report are not shown"))

    def __str__(self) -> str:
        """The report as text, one fact per line."""
        head = (
            f"camera {self.camera or '(framed)'}  size {self.width}x{self.height}  time {self.time_code:g}  "
            f"up {self.up_axis}  settings {self.settings or '(none)'}"
        )
        lines = [
            head,
            "counts " + ", ".join(f"{name} {n}" for name, n in sorted(self.counts.items())),
        ]
        lines += [f"assumed {a.what}: {a.reason}" for a in self.assumed]
        lines += [f"left out {x.path} {x.what}: {x.reason}" for x in self.left_out]
        lines += [f"note {x.path} {x.message}" for x in self.notes]
        lines += [f"effect {e.name}: {e.reason} ({', '.join(e.paths[:3])})" for e in self.effects]
        return "\n".join(lines)
