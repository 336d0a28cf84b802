import numpy as np
import pytest

from binocal.cameras import Camera
from binocal.detection.measuring.circle_shift import measure_circle_shift
from binocal.geometry import SE3
from binocal.geometry.so3 import exp
from binocal.kernels.image_lens import LensFitOptions

SIZE_WH = (1280, 960)
RADIUS_M = 0.0075


def shot(camera, tilt_rad, distance_m):
    """Circles of a 10x8 grid: places on the board, images of the centres, centroids and areas of the images."""
    xy = 0.03 * np.stack(np.meshgrid(np.arange(10), np.arange(8)), axis=-1).reshape(-1, 2)
    R = exp(np.array([0.8, 0.6, 0.0]) * tilt_rad)
    T = SE3(R, np.array([0.0, 0.0, distance_m]) - R @ np.array([0.135, 0.105, 0.0]))

    def project(plane):
        return camera.project(T.apply(np.concatenate([plane, np.zeros((len(plane), 1))], axis=1)))

    turn = 2 * np.pi * np.arange(720) / 720
    rim = RADIUS_M * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    outline = project((xy[:, None] + rim).reshape(-1, 2)).reshape(len(xy), -1, 2)
    following = np.roll(outline, -1, axis=1)
    cross = outline[..., 0] * following[..., 1] - outline[..., 1] * following[..., 0]
    area = cross.sum(axis=1) / 2
    return xy, project(xy), ((outline + following) * cross[..., None]).sum(axis=1) / (6 * area[:, None]), np.abs(area)


@pytest.mark.parametrize("tilt_rad", [0.0, 0.6, 1.0])
@pytest.mark.parametrize(
    ("camera", "distance_m", "bound_px"),
    [
        # measured: 0.00004, 0.007 (one corner; 0.0008 rms), 0.0013 px; the shift itself is up to 0.5 px
        (Camera("brown4", SIZE_WH, np.r_[1400, 1400, 640, 480, 0, -0.1, 0.02, 0, 0]), 0.45, 1e-4),
        (Camera("brown4", SIZE_WH, np.r_[1000, 1010, 650, 470, 0, -0.25, 0.08, 1e-3, -1e-3]), 0.35, 1e-2),
        (Camera("fisheye4", SIZE_WH, np.r_[490.0, 490, 640, 480, 0, 0, 0, 0, 0]), 0.25, 3e-3),
    ],
)
def test_nothing_is_left_of_the_shift(camera, distance_m, bound_px, tilt_rad):
    xy, truth, centroids, areas = shot(camera, tilt_rad, distance_m)
    inside = ((truth > 0) & (truth < SIZE_WH)).all(axis=1)
    shift = measure_circle_shift(
        xy[inside], centroids[inside], areas[inside], SIZE_WH, LensFitOptions(), np.ones(inside.sum())
    )
    assert np.abs(centroids[inside] - shift - truth[inside]).max() < bound_px


def test_without_a_plane_nothing_is_taken_out():
    xy, _, centroids, areas = shot(
        Camera("brown4", SIZE_WH, np.r_[1400, 1400, 640, 480, 0, -0.1, 0.02, 0, 0]), 0.6, 0.45
    )
    mirrored = xy * [-1, 1]  # seen from behind
    assert not measure_circle_shift(mirrored, centroids, areas, SIZE_WH, LensFitOptions(), np.ones(len(xy))).any()
