"""Samples for the related work's calibrators, and what is measured of their calibrations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.boards import Board, parse_board
from binocal.calibrators import calibrate
from binocal.calibrators.wide_field import mean_of_views
from binocal.cameras import StereoRig
from binocal.cameras.zoom_rig import ZoomRig, curve_quantities, rig_of_quantities
from binocal.evidence.zoom_settings import ZoomSettings
from binocal.experiments.bounds import bound_of_corners
from binocal.experiments.case import Made, Sample
from binocal.experiments.rendered import render_files
from binocal.experiments.row import Measured
from binocal.geometry import SE3, so3
from binocal.metrics import image
from binocal.metrics.binocular import binocular_error_px
from binocal.metrics.held_out import exact_views
from binocal.result import StereoCalibration
from binocal.shapes import Float
from binocal.simulation import (
    SETUPS,
    StereoScene,
    sample_board_poses,
    simulate_detections,
    table2_rig,
)
from binocal.simulation.turning import TurningOptions, TurningScene, simulate_turning, turning_rig
from binocal.simulation.zoom import zoom_rig_at
from binocal.solvers.covariance import cramer_rao_bound
from binocal.solvers.prior import RigPrior

N_EXACT = 20  # views for lengths
ZOOM_BOARD = "chessboard:11x8:20mm"


def board_corners(seed: int) -> Sample:
    """Corners of 20 pairs of the paper's rig, Gaussian noise of 0.2 px."""
    rng, rig, board = np.random.default_rng(seed), table2_rig(), parse_board("chessboard:11x8:20mm")
    scene = StereoScene(rig, board, sample_board_poses(rig, board, 20, rng))
    corners = simulate_detections(scene, rng, noise_px=0.2)
    bound = cramer_rao_bound(rig, board.object_points_m, scene.T_left_board, 0.2)
    return Sample(corners, rig, board, bound, {"model": "brown4"})


@dataclass(frozen=True, slots=True)
class Rendered:
    """Images of a named set-up to corners, as a user's are; the bound is that of the corners' own covariances."""

    setup: str
    spec: str
    model: str

    def __call__(self, seed: int) -> Sample:
        """See :class:`binocal.experiments.case.Case`."""
        chosen, board = SETUPS[self.setup](), parse_board(self.spec)
        rng = np.random.default_rng(seed)
        scene = StereoScene(chosen.rig, board, sample_board_poses(chosen.rig, board, 12, rng))
        corners = render_files(scene, chosen.with_lens_and_noise(0.8, 3.0), np.random.SeedSequence(seed)).corners()
        kept = scene.T_left_board[[int(name) for name in corners.names]]
        bound = bound_of_corners(chosen.rig, corners, kept)
        return Sample(corners, chosen.rig, board, bound, {"model": self.model})


def _calibration(made: Made) -> StereoCalibration:
    assert made.calibration is not None  # the methods of these cases are calibrators
    return made.calibration


def errors_of(rig: StereoRig, truth: StereoRig) -> Float[ndarray, "p"]:
    """Estimate minus truth in the order of a covariance without skew."""
    parts = [np.delete(getattr(rig, s).parameters - getattr(truth, s).parameters, 4) for s in ("left", "right")]
    turn = so3.log(rig.T_right_left.R @ truth.T_right_left.R.T)
    return np.concatenate([*parts, turn, rig.T_right_left.t - truth.T_right_left.t])


def rig_errors(made: Made, sample: Sample) -> list[Measured]:
    """Rotation, translation and lengths beside the bound; all parameters' errors over the bound and over what is stated."""
    e, bound, truth = errors_of(made.rig, sample.truth), sample.bound, sample.truth
    assert sample.board is not None and bound is not None  # cases of boards have both
    of_turn, of_shift = (np.sqrt(np.trace(bound.block(part))) for part in ("rotation", "translation"))
    exact, _ = exact_views(truth, sample.board, N_EXACT, 0)
    lengths = image.length_error(made.rig, exact, side_m=sample.board.pitch_m)
    over_bound = np.sqrt(np.mean(np.square(e) / np.diag(bound.matrix)))
    over_stated = np.sqrt(e @ np.linalg.solve(_calibration(made).covariance.matrix, e) / len(e))
    return [
        Measured("rotation error", "deg", float(np.degrees(np.linalg.norm(e[-6:-3]))), float(np.degrees(of_turn))),
        Measured("translation error", "mm", 1e3 * float(np.linalg.norm(e[-3:])), 1e3 * float(of_shift)),
        Measured("relative length error", "%", lengths.scale_rms_percent),
        Measured("errors over the bound, rms", "", float(over_bound)),
        Measured("errors over stated sigmas, rms", "", float(over_stated)),
    ]


def wide_errors(made: Made, sample: Sample) -> list[Measured]:
    """The same, and the binocular mean reprojection error beside that of the mean of the views' poses, on the same corners."""
    return [
        Measured("binocular mean reprojection error", "px", binocular_error_px(made.rig, sample.evidence)),
        Measured(
            "the same, mean of the views' poses",
            "px",
            binocular_error_px(mean_of_views(_calibration(made)), sample.evidence),
        ),
        *rig_errors(made, sample),
    ]


@dataclass(frozen=True, slots=True)
class Turning:
    """Cameras that turn before rectangles, known from a calibration of 20 pairs of a board with 0.1 px."""

    n_pairs: int
    sigma_deg: float
    is_always_another: bool = False
    pivot_m: float = 0.0

    def __call__(self, seed: int) -> Sample:
        """See :class:`binocal.experiments.case.Case`."""
        rng, rig, board = np.random.default_rng(seed), turning_rig(), parse_board("chessboard:11x8:60mm")
        scene = StereoScene(rig, board, sample_board_poses(rig, board, 20, rng))
        before = calibrate(simulate_detections(scene, rng, noise_px=0.1), calibrator="lm", model="brown4")
        options = TurningOptions(
            attitude_sigma_deg=self.sigma_deg, is_always_another=self.is_always_another, pivot_m=self.pivot_m
        )
        turned = simulate_turning(rig, self.n_pairs, rng, options)
        return Sample(turned.pairs, turned, choices={"prior": RigPrior.from_calibration(before)})


def turning_errors(made: Made, sample: Sample) -> list[Measured]:
    """Attitude, translation and 3-D coordinates of all pairs after the first, as each was known when it came; rms."""
    truth: TurningScene = sample.truth
    place = {name: i for i, name in enumerate(truth.pairs.names)}
    angles, shifts, relative = [], [], []
    for row in _calibration(made).provenance["rectangles"]["pairs"]:
        i = place[row["name"]]
        if i == 0:
            continue
        angles.append(np.radians([row["yaw_pitch_deg"]["left"], row["yaw_pitch_deg"]["right"]]) - truth.angles_rad[i])
        T = SE3(np.array(row["R"]), np.array(row["T"]))
        shifts.append(np.linalg.norm(T.t - truth.T_right_left.t[i]))
        relative.append(_coordinates(made.rig, T, truth, i))
    return [
        Measured("attitude, rms", "deg", float(np.degrees(np.sqrt(np.mean(np.square(angles)))))),
        Measured("translation, rms", "mm", 1e3 * float(np.sqrt(np.mean(np.square(shifts))))),
        Measured("coordinates, rms", "%", 100 * float(np.sqrt(np.mean(np.square(relative))))),
        Measured("pairs left out", "", float(len(_calibration(made).rejected))),
    ]


def _coordinates(rig: StereoRig, T: SE3, truth: TurningScene, pair: int) -> Float[ndarray, "4"]:
    """Distances of the triangulated corners from the true ones over their distance from the camera."""
    pairs, true_m = truth.pairs, truth.corners_left_m[pair]
    rays = rig.left.unproject(pairs.left_px[pair]), rig.right.unproject(pairs.right_px[pair]) @ T.R
    centre = T.inverse().t
    found = []
    for a, b in zip(*rays, strict=True):
        along = np.linalg.lstsq(np.stack([a, -b], axis=-1), centre, rcond=None)[0]
        found.append(0.5 * (along[0] * a + centre + along[1] * b))
    return np.linalg.norm(np.array(found) - true_m, axis=-1) / np.linalg.norm(true_m, axis=-1)


@dataclass(frozen=True, slots=True)
class Zoomed:
    """Corners of a board at settings spread over the range."""

    n_settings: int
    n_views: int = 12
    noise_px: float = 0.1

    def __call__(self, seed: int) -> Sample:
        """See :class:`binocal.experiments.case.Case`."""
        rng, board = np.random.default_rng(seed), parse_board(ZOOM_BOARD)
        settings, made = np.linspace(0, 1, self.n_settings), []
        for setting in settings:
            rig = zoom_rig_at(setting)
            scene = StereoScene(rig, board, sample_board_poses(rig, board, self.n_views, rng))
            made.append(simulate_detections(scene, rng, noise_px=self.noise_px))
        return Sample(ZoomSettings(settings, tuple(made)), None, board, choices={"model": "brown4"})


def zoom_errors(made: Made, sample: Sample) -> list[Measured]:
    """Relative length and row errors: of calibrations at the settings, of the curves there and between, of plain interpolation."""
    given: ZoomSettings = sample.evidence
    curves, settings = ZoomRig.from_document(_calibration(made).extra["zoom"]), given.settings
    own = [calibrate(d, calibrator="lm", model="brown4").rig for d in given.detections]
    points = np.stack([curve_quantities(rig, curves.middle) for rig in own])
    between = 0.5 * (settings[1:] + settings[:-1])

    def linear(at: float) -> StereoRig:
        return rig_of_quantities(np.array([np.interp(at, settings, q) for q in points.T]), curves.middle)

    def cubic(at: float) -> StereoRig:
        return rig_of_quantities(_cubic(settings, points, at), curves.middle)

    found = []
    for name, rigs, at in (
        ("each setting's own calibration", own, settings),
        ("curves, at the settings", [curves.rig_at(s) for s in settings], settings),
        ("curves, between them", [curves.rig_at(s) for s in between], between),
        ("straight lines, between them", [linear(s) for s in between], between),
        ("cubic through four, between them", [cubic(s) for s in between], between),
    ):
        errors = np.array([_lengths_and_rows(rig, s, sample.board) for rig, s in zip(rigs, at.tolist(), strict=True)])
        lengths, rows = np.sqrt(np.mean(np.square(errors), axis=0)).tolist()
        found += [Measured(f"length: {name}", "%", lengths), Measured(f"rows: {name}", "px", rows)]
    return found


def _cubic(x: Float[ndarray, "k"], y: Float[ndarray, "k q"], at: float) -> Float[ndarray, "q"]:
    """Through the four settings around, parameter by parameter (Lagrange)."""
    first = int(np.clip(np.searchsorted(x, at) - 2, 0, len(x) - 4))
    near, values = x[first : first + 4], y[first : first + 4]
    weights = [np.prod([(at - b) / (a - b) for b in near if b != a]) for a in near]
    return np.array(weights) @ values


def _lengths_and_rows(rig: StereoRig, setting: float, board: Board | None) -> tuple[float, float]:
    assert board is not None  # the cases of zooms have one
    exact, _ = exact_views(zoom_rig_at(setting), board, N_EXACT, 0)
    lengths = image.length_error(rig, exact, side_m=board.pitch_m)
    return lengths.scale_rms_percent, image.rectified_row_error(rig, exact).rms_px
