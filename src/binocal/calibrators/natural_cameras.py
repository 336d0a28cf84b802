"""What matches say of the cameras' own parameters, which are held: how uncertain those are, what is asked for, whose cameras they are."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera
from binocal.cameras.models import camera_model
from binocal.evidence.point_matches import PointMatches
from binocal.findings import finding, refusal
from binocal.result import Covariance
from binocal.shapes import Float
from binocal.solvers.epipolar import EpipolarProblem, Rays
from binocal.solvers.epipolar_covariance import slopes_by_intrinsics
from binocal.solvers.epipolar_diagnosis import Ask, CameraMisfit
from binocal.solvers.relative_pose import RelativePose

ASSUMED_FOCAL_SHARE, ASSUMED_ASPECT_SHARE, ASSUMED_CENTRE_PX = 4e-4, 2e-4, 0.25
ASSUMED_DISTORTION = {"k1": 8e-4, "k2": 1.6e-3, "p1": 5e-5, "p2": 5e-5}
"""What intrinsics are uncertain by where nobody says: as a good calibration from a board leaves them."""
OTHER_SHARE, OTHER_PX = 0.35, 0.045
"""Of the squared residuals, and RMS in pixels, that only other cameras explain, for those held to be of another rig. Good calibrations
leave up to 0.31 where it is 0.03 px (EuRoC, KITTI's grey cameras), and up to 0.19 where it is 0.056 px."""


def intrinsics_covariance(cameras: tuple[Camera, Camera], known: Covariance | None) -> Float[ndarray, "p p"]:
    """Covariance of all parameters of both cameras, left first: what a rig file says of them, or what is assumed."""
    names = [
        f"{side}.{n}"
        for side, c in zip(("left", "right"), cameras, strict=True)
        for n in camera_model(c.model).parameter_names
    ]
    out = np.zeros((len(names), len(names)))
    if known is not None and any(name in known.names for name in names):
        place = {name: i for i, name in enumerate(known.names)}
        here = [i for i, name in enumerate(names) if name in place]
        there = [place[names[i]] for i in here]
        out[np.ix_(here, here)] = known.matrix[np.ix_(there, there)]
        return out
    return assumed_covariance(cameras, of_no_lens=False)


def assumed_covariance(cameras: tuple[Camera, Camera], *, of_no_lens: bool) -> Float[ndarray, "p p"]:
    """What a good calibration leaves uncertain; ``of_no_lens``: of the distortion too where there is said to be none."""
    n = sum(len(camera.parameters) for camera in cameras)
    out = np.zeros((n, n))
    first = 0
    for camera in cameras:
        f = float(camera.parameters[0])
        out[first, first] = out[first + 1, first + 1] = out[first, first + 1] = out[first + 1, first] = (
            ASSUMED_FOCAL_SHARE * f
        ) ** 2
        out[first + 1, first + 1] += (ASSUMED_ASPECT_SHARE * f) ** 2
        out[first + 2, first + 2] = out[first + 3, first + 3] = ASSUMED_CENTRE_PX**2
        for i, name in enumerate(camera_model(camera.model).distortion_names):
            is_known_zero = not camera.distortion.any()  # rectified images: what is left of the lens is not said
            is_left_out = is_known_zero and not of_no_lens
            out[first + 5 + i, first + 5 + i] = 0.0 if is_left_out else ASSUMED_DISTORTION.get(name, 0.0) ** 2
        first += len(camera.parameters)
    return out


def slopes_of(
    problem: EpipolarProblem,
    matches: PointMatches,
    estimate: RelativePose,
    cameras: tuple[Camera, Camera],
    sigma: Float[ndarray, "p"],
) -> Float[ndarray, "n p"]:
    """Derivatives of the residuals by the parameters of both cameras, left first; 0 for those without a standard deviation."""

    def of_other_cameras(pair: tuple[Camera, Camera]) -> EpipolarProblem:
        left = problem.left if pair[0] is cameras[0] else Rays.of_points(pair[0], matches.left_px)
        right = problem.right if pair[1] is cameras[1] else Rays.of_points(pair[1], matches.right_px)
        return EpipolarProblem(left, right)

    return slopes_by_intrinsics(of_other_cameras, cameras, estimate, sigma, len(matches))


def is_of_other_cameras(misfit: CameraMisfit | None) -> TypeGuard[CameraMisfit]:
    """Whether most of the residuals are a pattern that the images' own cameras would not leave."""
    return misfit is not None and misfit.share >= OTHER_SHARE and misfit.pattern_px >= OTHER_PX


def refuse_other_cameras(misfit: CameraMisfit | None) -> None:
    """Raises InconsistentViewsError: most of the residuals are a pattern that the images' own cameras would not leave."""
    if not is_of_other_cameras(misfit):
        return
    share_percent = 100 * misfit.share
    raise refusal(
        finding("cameras-are-others", held_px=misfit.held_px, pattern_px=misfit.pattern_px, share_percent=share_percent)
    )


def parameters_asked_for(
    cameras: tuple[Camera, Camera], slopes: Float[ndarray, "n p"]
) -> dict[str, Float[ndarray, "n"]]:
    """Derivatives of the residuals by what may be asked of each camera: focal length (its share), principal point, k1."""
    found: dict[str, Float[ndarray, "n"]] = {}
    first = 0
    for side, camera in zip(("left", "right"), cameras, strict=True):
        names = camera_model(camera.model).parameter_names
        own = slopes[:, first : first + len(names)]
        found[f"{side}.f"] = own[:, :2] @ camera.parameters[:2]
        for name in ("cx", "cy", "k1"):
            found[f"{side}.{name}"] = own[:, names.index(name)]
        first += len(names)
    return found


def asked(ask: Ask) -> str:
    """What is asked for, in words."""
    side, name = ask.name.split(".")
    if name == "f":
        return f"a focal length of the {side} camera that is {100 * ask.change:+.2f} ± {100 * ask.sigma:.2f} % another"
    if name == "k1":
        return f"a k1 of the {side} camera that is {ask.change:+.4f} ± {ask.sigma:.4f} another"
    return f"a principal point of the {side} camera that lies {ask.change:+.1f} ± {ask.sigma:.1f} px away in {name[1]}"
