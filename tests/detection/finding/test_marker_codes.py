from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocal.detection.finding.marker_codes import CodeKind, cell_places, code_templates
from binocal.detection.finding.markers import get_dictionary
from binocal.kernels.marker_grids import FieldLens, read_cells

KIND = CodeKind("DICT_5X5_50", 1, 0.1, 0.125)


def draw_face(marker, blur_px=0.0, side_px=80):
    """A white face with a marker in its middle, and the face's corners."""
    drawn = cv2.aruco.generateImageMarker(get_dictionary(KIND.dictionary), marker, round(0.8 * side_px))
    face = cv2.copyMakeBorder(drawn, *[20 + side_px // 10] * 4, cv2.BORDER_CONSTANT, value=255)
    quad = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * side_px + 19.5
    return cv2.GaussianBlur(face, (0, 0), blur_px) if blur_px else face, quad


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("blur_cells", [0.2, 0.8])
def test_drawn_markers_are_like_their_own_template_in_their_own_turn(turn, blur_cells):
    templates = code_templates(KIND, 3, 10, blur_cells)
    assert templates.ids.tolist() == list(range(3, 13))
    for k in (0, 7):
        face, quad = draw_face(3 + k, blur_px=blur_cells * 64 / 7)
        read = read_cells(face, np.roll(quad, turn, axis=0)[None], cell_places(KIND), FieldLens())
        likeness = (templates.residual(read) @ templates.turned.reshape(40, -1).T).reshape(10, 4)
        assert np.unravel_index(likeness.argmax(), likeness.shape) == (k, turn)
        assert likeness[k, turn] > 0.97 and np.sort(likeness.ravel())[-2] < 0.8


def test_a_mirror_image_is_like_the_mirrored_template_alone():
    templates = code_templates(KIND, 0, 50, 0.2)
    face, quad = draw_face(4)
    read = read_cells(np.ascontiguousarray(face[:, ::-1]), quad[None], cell_places(KIND), FieldLens())
    rest = templates.residual(read)
    assert (rest @ templates.mirrored.reshape(200, -1).T).max() > 0.97
    assert (rest @ templates.turned.reshape(200, -1).T).max() < 0.72


def test_what_is_plain_is_like_nothing():
    templates = code_templates(KIND, 0, 50, 0.5)
    plain = np.linspace(10, 200, 77, dtype=np.float32)[None] * 0 + 120
    assert np.array_equal(templates.residual(plain), np.zeros_like(plain))
