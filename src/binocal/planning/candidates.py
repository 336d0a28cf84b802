"""Views that could be taken, and what each would tell of the rig."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.errors import SceneError
from binocal.geometry import SE3, so3
from binocal.shapes import Float
from binocal.simulation import PoseOptions, sample_board_poses
from binocal.simulation.visibility import visible_px
from binocal.solvers.board_views import BundleEstimate, BundleProblem, CameraObservations
from binocal.solvers.covariance import shared_names

N_CANDIDATES = 400  # of twice as many the best four are better by 1 to 2 %
OPTIONS = PoseOptions(fill=(0.3, 1.2), tilt_deg=(5.0, 50.0))
"""Nearer and more tilted than a person would choose: such views tell most."""
SEED = 20_240  # of the candidates: the same rig gets the same plan


@dataclass(frozen=True, slots=True, eq=False)
class CandidateViews:
    """Board poses that both cameras see whole, and each one's information of the rig's parameters for a noise of 1 px.

    ``information`` is in the order of ``names``, a covariance's: the translation is additive. The board poses are free.
    """

    T_left_board: SE3
    names: tuple[str, ...]
    information: Float[ndarray, "k p p"]


def candidate_views(rig: StereoRig, board: Board, names: tuple[str, ...], n: int = N_CANDIDATES) -> CandidateViews:
    """Candidates spread over image, tilts and distances; fewer where the board hardly fits into both images.

    ``names`` are the parameters that are estimated.

    Raises:
        SceneError: The board cannot be seen whole by both cameras.
    """
    poses = _poses(rig, board, n)
    return CandidateViews(poses, names, information_of_views(rig, board.object_points_m, poses, names))


def _poses(rig: StereoRig, board: Board, n: int) -> SE3:
    rng = np.random.default_rng(SEED)
    while True:
        try:
            return sample_board_poses(rig, board, n, rng, OPTIONS)
        except SceneError:
            if n < 10:
                raise
            n //= 4  # those that fit are few: look for as many as there are


def information_of_views(
    rig: StereoRig, points_m: Float[ndarray, "n 3"], T_left_board: SE3, names: tuple[str, ...]
) -> Float[ndarray, "k p p"]:
    """Each view's information of the named parameters, its board pose free, for a noise of 1 px; exact corners where they are seen."""
    cameras = []
    for side, camera, T in (("left", rig.left, T_left_board), ("right", rig.right, rig.T_right_left @ T_left_board)):
        own = [f"{side}.{name}" in names for name in camera_model(camera.model).parameter_names]
        cameras.append(_observed(camera, T, points_m, np.array(own)))
    problem = BundleProblem(np.ascontiguousarray(points_m.T), (cameras[0], cameras[1]))
    estimate = BundleEstimate.of_rig(rig, T_left_board[:, None])
    H = problem.shared_information(estimate, problem.linearize(estimate, np.ones(len(T_left_board.t)), "squared"))
    prior = np.concatenate([c.prior_precision[c.is_free] for c in problem.cameras] + [np.zeros(6)])
    H = H - np.diag(prior)
    # the solver's left step moves t by tau + omega x t: from steps of t itself to those
    to_left = np.eye(H.shape[-1])
    to_left[-3:, -6:-3] = so3.hat(rig.T_right_left.t)
    H = to_left.T @ H @ to_left
    order = shared_names(problem)
    places = [order.index(name) for name in names]
    H = H[:, places][:, :, places]  # what is held of the rig is known: its rows go
    return 0.5 * (H + H.swapaxes(1, 2))


def _observed(camera: Camera, T: SE3, points_m: Float[ndarray, "n 3"], is_free: ndarray) -> CameraObservations:
    px = visible_px(camera, T.apply(points_m))
    seen = np.isfinite(px[..., 0])
    pixels = np.ascontiguousarray(np.where(seen[..., None], px, 0.0).swapaxes(-1, -2))
    return CameraObservations(camera_model(camera.model), pixels[:, None], seen[:, None], is_free)
