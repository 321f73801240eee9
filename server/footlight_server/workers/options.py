"""From a render spec to the core's options."""

import footlight_core
from footlight.v1 import render_pb2
from footlight_server.images.display import check_view
from footlight_server.workers.causes import failing_as
from footlight_server.workers.failure import FailureReason

_FILTERS = {
    render_pb2.PIXEL_FILTER_BOX: "box",
    render_pb2.PIXEL_FILTER_GAUSSIAN: "gaussian",
    render_pb2.PIXEL_FILTER_BLACKMAN_HARRIS: "blackman-harris",
}
_STRATEGIES = {
    render_pb2.STRATEGY_MIS: "mis",
    render_pb2.STRATEGY_LIGHT: "light",
    render_pb2.STRATEGY_BSDF: "bsdf",
}
# Always in the image.
_BASE_AOVS = ("color", "alpha")


def aovs_of(spec: render_pb2.RenderSpec) -> list[str]:
    """Names of the images to make, the base ones first."""
    return [*_BASE_AOVS, *(aov for aov in spec.aovs if aov not in _BASE_AOVS)]


def options_of(spec: render_pb2.RenderSpec, width: int, height: int) -> footlight_core.RenderOptions:
    """For an image of this size [pixels]. Raises ValueError."""
    return footlight_core.RenderOptions(
        width=width,
        height=height,
        seed=spec.seed,
        max_depth=spec.max_depth,
        pixel_filter=_FILTERS[spec.pixel_filter],
        filter_width=spec.filter_width,
        strategy=_STRATEGIES[spec.strategy],
        aovs=aovs_of(spec),
        threads=spec.threads,
        force_effects=list(spec.force_effects),
    )


def check_options(spec: render_pb2.RenderSpec) -> None:
    """What can be known to be wrong before the stage is read. Raises TaskFailedError."""
    with failing_as(FailureReason.INVALID_ARGUMENT, ValueError):
        options = options_of(spec, spec.width or 1, spec.height or 1)
        if spec.force_effects:  # their names are looked at when a scene is committed
            footlight_core.Renderer(footlight_core.Scene(), options)
        if spec.HasField("png"):
            check_view(spec.png.view)
