"""The paper's boards before the rig of its table 2, rendered: half of the pairs calibrate, the other half tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from binocal.boards import Board, parse_board
from binocal.cameras import Camera, StereoRig
from binocal.datasets.folder import ImagePair
from binocal.detection.opencv_finder import detect_with_opencv
from binocal.errors import DetectionError
from binocal.evidence import Detections
from binocal.experiments.bounds import bound_of_corners
from binocal.experiments.case import Made, Sample
from binocal.experiments.rendered import render_files
from binocal.experiments.row import Measured
from binocal.geometry import SE3
from binocal.metrics import image
from binocal.metrics.pose import compare_with_truth
from binocal.simulation import PoseOptions, RenderOptions, StereoScene, sample_board_poses, table2_rig
from binocal.simulation.printed_shape import draw_printed_shape, printed_points_information
from binocal.solvers.poses import estimate_board_poses

MODEL = "brown4"  # the paper's: two radial and two tangential coefficients
FILL = (0.25, 0.70)  # of the image's width or height
CORRECT_IF_KNOWN = "parameters correct by the bound of a board that is known exactly"
LOOKS = RenderOptions(blur_px=0.8, noise_dn=3.0)


def nominal_rig() -> StereoRig:
    """What the data sheet of the paper's table 2 says: f = 6 mm on pixels of 3.75 µm, 60 mm apart, parallel, without distortion."""
    camera = Camera(MODEL, (1280, 960), np.array([1600.0, 1600.0, 639.5, 479.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    return StereoRig(camera, camera, SE3(np.eye(3), np.array([-0.060, 0.0, 0.0])))


@dataclass(frozen=True, slots=True)
class RenderedBoards:
    """Samples of ``n_pairs`` rendered pairs of a board, found as a user's images are."""

    spec: str
    n_pairs: int
    bow_m: float = 0.0
    print_error_m: float = 0.0

    def __call__(self, seed: int) -> Sample:
        """The corners of the first half to calibrate from, those of the second to measure lengths on.

        The board is given as it is drawn; lengths are compared with the board as it is.
        """
        rng, rig, board = np.random.default_rng([seed, 3]), table2_rig(), parse_board(self.spec)
        scene = StereoScene(rig, board, sample_board_poses(rig, board, self.n_pairs, rng, PoseOptions(fill=FILL)))
        looks, true_m, information = LOOKS, board.object_points_m, None
        if self.bow_m or self.print_error_m:
            shape = draw_printed_shape(board, rng, bow_m=self.bow_m, error_m=self.print_error_m)
            looks, true_m = replace(LOOKS, shape=shape), shape.points_m(board)
            information = printed_points_information(board, bow_m=self.bow_m, error_m=self.print_error_m)
        files = render_files(scene, looks, np.random.SeedSequence([seed, 4]))
        corners = files.corners()
        place = np.array([int(name) for name in corners.names])
        first, second = (np.flatnonzero(part) for part in (place < self.n_pairs // 2, place >= self.n_pairs // 2))
        evidence = corners.select(first)
        placed, as_it_is = scene.T_left_board[place[first]], replace(evidence, object_points_m=true_m)
        bound = bound_of_corners(rig, as_it_is, placed, information)
        exact = None if information is None else bound_of_corners(rig, as_it_is, placed)
        held_out = replace(corners.select(second), object_points_m=true_m)
        theirs = _by_opencv(files.pairs[: self.n_pairs // 2], board)
        return Sample(evidence, rig, board, bound, {"model": MODEL}, held_out, nominal_rig(), None, theirs, exact)


def _by_opencv(pairs: Sequence[ImagePair], board: Board) -> Detections | None:
    try:
        return detect_with_opencv(pairs, board)
    except DetectionError:
        return None


def board_errors(made: Made, sample: Sample) -> list[Measured]:
    """The paper's criteria on the held-out half, and the parameters against the truth."""
    rig, held_out = made.rig, sample.held_out
    assert held_out is not None and sample.board is not None  # cases of boards have both
    lengths = image.length_error(rig, held_out, side_m=sample.board.pitch_m)
    poses = estimate_board_poses(rig, held_out)
    pixels = image.pixel_error(rig, held_out, poses.T_left_board)
    truth = compare_with_truth(rig, sample.truth, bound=sample.bound, has_skew=False)
    found = [
        Measured("relative length error", "%", lengths.scale_rms_percent),
        Measured("error of a single side", "%", lengths.side_rms_percent),
        Measured("pixel error (eq. 19)", "px", pixels.all_px),
        Measured("rotation error", "deg", truth.rotation_error_deg, truth.rotation_bound_deg),
        Measured("translation error", "mm", truth.translation_error_mm, truth.translation_bound_mm),
        Measured("parameters correct (eq. 20)", "%", truth.parameter_accuracy_percent, table="figure 6"),
    ]
    if sample.known_board_bound is not None:
        known = compare_with_truth(rig, sample.truth, bound=sample.known_board_bound, has_skew=False)
        found.append(Measured(CORRECT_IF_KNOWN, "%", known.parameter_accuracy_percent, table="figure 6"))
    if made.calibration is not None:
        if made.calibration.n_iterations:  # cv2 does not say how many it took
            found.append(Measured("iterations", "", float(made.calibration.n_iterations), table="figure 5"))
        of_truth = truth.parameters
        found += [Measured(p.name, "", p.truth + p.error, p.bound, "parameters") for p in of_truth]
        found += [Measured(p.name, "sigmas", p.error_per_bound, table="errors") for p in of_truth if p.bound > 0]
    return found
