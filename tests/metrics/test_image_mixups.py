"""Images that a rig explains only exchanged, mirrored, upside down or paired otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocal.app.corners import FoundCorners
from binocal.app.evaluate import evaluate_images
from binocal.boards import parse_board
from binocal.errors import DataError
from binocal.evidence import Detections
from binocal.findings import findings_of
from binocal.metrics.image_mixups import find_mixup
from binocal.metrics.order import order_corners
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

pytestmark = pytest.mark.usefixtures("many_calls")

BOARD = parse_board("chessboard:9x6:30mm")
RIG = table2_rig()
LAST = np.array(RIG.left.size_wh) - 1.0


def corners(n_views: int = 6) -> Detections:
    rng = np.random.default_rng(0)
    return simulate_detections(StereoScene(RIG, BOARD, sample_board_poses(RIG, BOARD, n_views, rng)), rng, noise_px=0.2)


def mirrored(px: np.ndarray) -> np.ndarray:
    """As a finder numbers the corners of a flipped image: row by row from its own left."""
    flipped = px * [-1, 1] + [LAST[0], 0]
    return flipped.reshape(-1, 6, 9, 2)[:, :, ::-1].reshape(px.shape)


SEEN = corners()
MIXED_UP = {
    "left and right are exchanged": replace(SEEN, left_px=SEEN.right_px, right_px=SEEN.left_px),
    "the left images are mirrored": replace(SEEN, left_px=mirrored(SEEN.left_px)),
    "the right images are mirrored": replace(SEEN, right_px=mirrored(SEEN.right_px)),
    "the left and right images are mirrored": replace(
        SEEN, left_px=mirrored(SEEN.left_px), right_px=mirrored(SEEN.right_px)
    ),
    "the right images are upside down": replace(SEEN, right_px=LAST - SEEN.right_px),
    # nearly as well explained by exchanged cameras: a rig turned by 180 degrees about its optical axes
    "the left and right images are upside down": replace(
        SEEN, left_px=LAST - SEEN.left_px, right_px=LAST - SEEN.right_px
    ),
    "are off by one image (left 0 belongs to right 1)": replace(SEEN, right_px=np.roll(SEEN.right_px, 1, axis=0)),
}

MIXED_UP |= {
    f"the board is {1 / factor:.3g} times as large as stated": replace(
        SEEN, object_points_m=factor * SEEN.object_points_m
    )
    for factor in (10.0,)
}


@pytest.mark.parametrize("how", MIXED_UP)
def test_images_that_fit_otherwise_are_refused_by_what_was_done(how, monkeypatch):
    found = FoundCorners(MIXED_UP[how], (), (), (), {})
    monkeypatch.setattr("binocal.app.evaluate.find_corners", lambda *_, **__: found)
    with pytest.raises(DataError, match="do not fit the rig as given") as caught:
        evaluate_images(RIG, "l", "r", BOARD)
    (refused,) = findings_of(caught.value)
    assert refused.code == "images-mixed-up" and refused.figures["how"].endswith(how) and refused.remedy
    assert refused.figures["mended_px"] < 1 < refused.figures["given_px"]


def test_right_images_and_another_rig_are_no_mixup():
    turned = replace(RIG, left=replace(RIG.left, parameters=RIG.left.parameters * np.r_[1.1, 1.1, np.ones(7)]))
    for rig in (RIG, turned):
        assert find_mixup(rig, SEEN, order_corners(rig, SEEN)) is None
    one = SEEN.select(np.array([0]))
    one = replace(one, left_px=one.right_px, right_px=one.left_px)
    assert find_mixup(RIG, one, order_corners(RIG, one)) is None  # may be by chance
    # whatever far boards nearly fit: a large one, of another rig, is no mirrored one
    large = replace(SEEN, object_points_m=30 * SEEN.object_points_m)
    assert find_mixup(turned, large, order_corners(turned, large)) is None
