"""Laws of the shared pixels."""

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from footlight_server.workers.film import create_film, open_film, shape_of


@given(st.integers(1, 300), st.integers(1, 300))
def test_tiles_cover_the_image_once(width: int, height: int) -> None:
    shape = shape_of(width, height, [("color", 3)])
    covered = np.zeros((height, width), int)
    for tile in range(shape.tiles):
        box = shape.box(tile)
        covered[box.y : box.y + box.height, box.x : box.x + box.width] += 1
    assert (covered == 1).all()


def test_the_server_sees_what_the_worker_writes_and_cannot_write_itself() -> None:
    shape = shape_of(70, 50, [("color", 3), ("depth", 1)])
    written, descriptor = create_film(shape)
    seen = open_film(shape, os.dup(descriptor))
    os.close(descriptor)
    written.planes["color"][3, 4] = (1, 2, 3)
    written.planes["depth"][:] = 9
    assert seen.planes["color"][3, 4].tolist() == [1, 2, 3]
    assert (seen.planes["depth"] == 9).all()
    assert not seen.planes["color"].flags.writeable


def test_memory_that_could_shrink_under_the_server_is_refused() -> None:
    shape = shape_of(64, 64, [("color", 3)])
    loose = os.memfd_create("loose", os.MFD_ALLOW_SEALING)
    os.ftruncate(loose, shape.bytes)
    with pytest.raises(ValueError, match="could shrink"):
        open_film(shape, loose)


def test_memory_smaller_than_its_shape_is_refused() -> None:
    _, descriptor = create_film(shape_of(64, 64, [("color", 3)]))
    with pytest.raises(ValueError, match="smaller"):
        open_film(shape_of(64, 65, [("color", 3)]), descriptor)


def test_the_worker_cannot_shrink_a_film() -> None:
    _, descriptor = create_film(shape_of(64, 64, [("color", 3)]))
    with pytest.raises(PermissionError):
        os.ftruncate(descriptor, 0)
    os.close(descriptor)
