"""Options become the message's fields under the same names, and what cannot is refused by name."""

from pathlib import Path
from typing import get_args

import pytest

from footlight.plain import plain
from footlight.spec import PIXEL_FILTERS, STRATEGIES, PixelFilter, Strategy, render_spec
from footlight.v1 import render_pb2, stats_pb2


def test_names_are_those_of_the_proto() -> None:
    for known, words, enum, prefix in (
        (PIXEL_FILTERS, PixelFilter, render_pb2.PixelFilter, "PIXEL_FILTER_"),
        (STRATEGIES, Strategy, render_pb2.Strategy, "STRATEGY_"),
    ):
        by_name = {f"{prefix}{name.upper().replace('-', '_')}": value for name, value in known.items()}
        assert by_name == {name: value for name, value in enum.items() if value != 0}
        assert set(known) == set(get_args(words))


def test_every_field_of_the_message_can_be_set() -> None:
    spec = render_spec(
        "a.usda",
        camera="/cam",
        time_code=0.0,
        size=(3, 2),
        spp=1,
        seed=2,
        max_depth=3,
        threads=4,
        pixel_filter="box",
        filter_width=2.0,
        strategy="bsdf",
        aovs=["depth"],
        strict=True,
        time_limit_seconds=1.0,
        error_limit=0.1,
        view="Raw",
        force_effects=["dome"],
        bundle="ab/7",
    )
    assert {field.name for field, _ in spec.ListFields()} == {field.name for field in spec.DESCRIPTOR.fields}
    assert spec.stage_path == "a.usda"
    assert spec.HasField("time_code")


def test_a_stage_is_a_path_from_here_unless_it_is_uploaded() -> None:
    assert render_spec("a.usda").stage_path == str(Path.cwd() / "a.usda")
    assert render_spec("a.usda", bundle="ab/7").stage_path == "a.usda"


def test_what_is_not_said_is_left_to_the_server() -> None:
    assert [field.name for field, _ in render_spec("/a.usda").ListFields()] == ["stage_path"]
    assert render_spec("/a.usda", png=True).HasField("png")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"spp": -1}, "spp: -1"),
        ({"seed": 2**32}, "seed: 4294967296 is not allowed; allowed are 0 to 4294967295"),
        ({"size": (2**40, 1)}, "width: 1099511627776"),
        ({"pixel_filter": "sinc"}, "pixel_filter: 'sinc' is not one of box, gaussian, blackman-harris"),
        ({"strategy": "luck"}, "strategy: 'luck' is not one of mis, light, bsdf"),
    ],
)
def test_what_a_message_cannot_hold_is_refused_by_name(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        render_spec("a.usda", **options)  # type: ignore[arg-type]


def test_plain_values_keep_numbers_names_and_zeros() -> None:
    stats = stats_pb2.RenderStats(rays={"closest": 2**40}, seed=0)
    stats.seconds.render = 1.5
    found = plain(stats)
    assert set(found) == {field.name for field in stats.DESCRIPTOR.fields}
    assert found["rays"] == {"closest": 2**40}
    assert found["seconds"] == {"open": 0.0, "translate": 0.0, "commit": 0.0, "render": 1.5, "write": 0.0, "total": 0.0}
    assert found["seed"] == 0
    assert found["error_mean"] is None
    assert plain(render_pb2.Render(state=render_pb2.RENDER_STATE_QUEUED))["state"] == "RENDER_STATE_QUEUED"
