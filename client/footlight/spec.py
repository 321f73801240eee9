"""What to render, from plain Python values to the message."""

import os
from collections.abc import Iterable, Mapping
from typing import Literal, TypeVar

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from footlight.paths import absolute
from footlight.v1 import render_pb2

PixelFilter = Literal["box", "gaussian", "blackman-harris"]
Strategy = Literal["mis", "light", "bsdf"]
Value = TypeVar("Value")

PIXEL_FILTERS = {
    "box": render_pb2.PIXEL_FILTER_BOX,
    "gaussian": render_pb2.PIXEL_FILTER_GAUSSIAN,
    "blackman-harris": render_pb2.PIXEL_FILTER_BLACKMAN_HARRIS,
}
STRATEGIES = {
    "mis": render_pb2.STRATEGY_MIS,
    "light": render_pb2.STRATEGY_LIGHT,
    "bsdf": render_pb2.STRATEGY_BSDF,
}
# What whole numbers of a message hold.
_MOST = {FieldDescriptor.TYPE_UINT32: (1 << 32) - 1, FieldDescriptor.TYPE_UINT64: (1 << 64) - 1}


def render_spec(
    stage: str | os.PathLike[str],
    *,
    camera: str = "",
    time_code: float | None = None,
    size: tuple[int, int] | None = None,
    spp: int = 0,
    seed: int = 0,
    max_depth: int = 0,
    threads: int = 0,
    pixel_filter: PixelFilter | None = None,
    filter_width: float = 0.0,
    strategy: Strategy | None = None,
    aovs: Iterable[str] = (),
    strict: bool = False,
    time_limit_seconds: float = 0.0,
    error_limit: float = 0.0,
    png: bool = False,
    view: str = "",
    force_effects: Iterable[str] = (),
    bundle: str = "",
) -> render_pb2.RenderSpec:
    """The RenderSpec for `stage`, whose comments say what each option means and its default (0, None, "").

    `size` is (width, height) [pixels]. A relative path is taken from the current directory; with a `bundle`, as
    `Client.upload` names it, `stage` is the path of one of its files. Raises ValueError for names that are not known
    and numbers that a message cannot hold, naming the option.
    """
    path = os.fspath(stage) if bundle else absolute(stage)
    spec = render_pb2.RenderSpec(stage_path=path, bundle=bundle, camera_path=camera, strict=strict)
    width, height = size or (0, 0)
    set_numbers(
        spec,
        time_code=time_code,
        width=width,
        height=height,
        spp=spp,
        seed=seed,
        max_depth=max_depth,
        threads=threads,
        filter_width=filter_width,
        time_limit_seconds=time_limit_seconds,
        error_limit=error_limit,
    )
    if pixel_filter is not None:
        spec.pixel_filter = by_name(PIXEL_FILTERS, "pixel_filter", pixel_filter)
    if strategy is not None:
        spec.strategy = by_name(STRATEGIES, "strategy", strategy)
    spec.aovs.extend(aovs)
    spec.force_effects.extend(force_effects)
    if png or view:
        spec.png.view = view
        spec.png.SetInParent()
    return spec


def set_numbers(message: Message, **numbers: float | None) -> None:
    """Set fields but for those that are None. Raises ValueError for a number that a field cannot hold, naming it."""
    for field, value in numbers.items():
        if value is None:
            continue
        try:
            setattr(message, field, value)
        except (ValueError, TypeError) as error:
            most = _MOST.get(message.DESCRIPTOR.fields_by_name[field].type)
            allowed = f"; allowed are 0 to {most}" if most else ""
            raise ValueError(f"{field}: {value} is not allowed{allowed}") from error


def by_name(known: Mapping[str, Value], field: str, name: str) -> Value:
    """What `name` stands for. Raises ValueError that lists the names."""
    if name not in known:
        raise ValueError(f"{field}: {name!r} is not one of {', '.join(known)}")
    return known[name]
