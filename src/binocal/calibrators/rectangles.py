"""``rectangles``: cameras that turn in yaw and pitch, followed on line by one rectangle of unknown size per pair.

Known are both cameras and the pose between them before they turned (the prior); an attitude sensor says roughly how each has turned.
Each pair is solved as it comes (:mod:`binocal.solvers.turning_cameras`), and what it says of its rectangle is kept for the next pair
that shows the same one. Pairs whose corners contradict their attitudes are refused (:mod:`binocal.calibrators.rectangle_checks`). The
rig is that of the last pair; the others are in the provenance.

Source: the paper's related work [10], Wang, Wang & Yin 2019 (10.1063/1.5086352): a rough attitude, each camera's angles from the
homography of one rectangle, yaw and pitch corrected through the fundamental matrix. Deviations: one most probable estimate from all
corners of both cameras in place of two steps from their centroid; standard deviations, those of cameras and initial rig included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.acceptance import left_out_findings
from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.rectangle_checks import check_agreement, check_inside
from binocal.calibrators.rectangle_pairs import follow, is_fitting, settle
from binocal.calibrators.registry import refuse_unsuited
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.errors import NotConvergedError
from binocal.evidence.rectangles import RectanglePairs
from binocal.findings import finding, refusal
from binocal.geometry import SE3, so3
from binocal.result import Covariance, RejectedView, ResidualSummary, StereoCalibration, ViewResult
from binocal.shapes import Float
from binocal.solvers.prior import RigPrior
from binocal.solvers.turning_cameras import PairSolve, rig_at, rig_by_angles

NAME = "rectangles"
SIDES = ("left", "right")
MOST_TURN_SIGMA_DEG = 1.0
BETTER = "keep the rectangle in view that the cameras saw before they turned, show a larger or nearer one, or use a better attitude sensor"
STEP_SIGMA = 0.1  # of the prior, for derivatives by it


def calibrate_rectangles(evidence: RectanglePairs, request: CalibrationRequest) -> StereoCalibration:
    """The rig as the cameras stand in the last pair (see :class:`binocal.calibrators.base.Calibrator`).

    Covariance: of the angles from the last pair's equations, and of the prior through all pairs to first order. The option
    ``noise_px`` states the corners' noise, which is estimated otherwise.
    """
    if not isinstance(evidence, RectanglePairs):
        raise TypeError(f"calibrator {NAME!r} works from RectanglePairs; got {type(evidence).__name__}")
    request.check_options("noise_px")
    refuse_unsuited(NAME, request)
    assert request.prior is not None  # unsuited without
    prior, pairs = request.prior, evidence.in_one_turn()
    stated = request.options.get("noise_px")
    if stated is not None and not stated > 0:
        raise ValueError(f"noise_px must be above 0; got {stated}")
    stated = None if stated is None else float(stated)
    check_inside(prior.rig, pairs)
    noise_px, solves = settle(prior.rig, pairs, stated, request.check_stop)
    checked = check_agreement(prior.rig, pairs, solves, stated, request.check_stop)
    if checked.pairs is not pairs:  # attitudes that count less
        pairs = checked.pairs
        noise_px, solves = settle(prior.rig, pairs, stated, request.check_stop)
    used = [i for i, solve in enumerate(solves) if is_fitting(solve)]
    rejected = _rejected(pairs, solves)
    if not used:
        raise NotConvergedError(
            f"none of the {pairs.n_pairs} pairs fits a rectangle before the cameras; {rejected[0].name}: {rejected[0].reason}",
            {view.name: view.reason for view in rejected},
        )
    last = solves[used[-1]]
    assert last is not None  # it is used
    T_right_left = rig_at(prior.rig, last.angles_rad)
    covariance = _covariance(prior, pairs, noise_px, solves, used[-1], request)
    rig = replace(prior.rig, T_right_left=T_right_left)
    sigma_deg = float(np.degrees(np.sqrt(np.diag(covariance.block("rotation")).max())))
    if sigma_deg > MOST_TURN_SIGMA_DEG:
        raise refusal(finding("rotation-undetermined", remedy=BETTER, sigma_deg=sigma_deg))
    return StereoCalibration(
        rig=rig,
        covariance=covariance,
        rms=_rms([solves[i] for i in used]),
        noise_px=noise_px,
        views=tuple(_view(pairs.names[i], solves[i]) for i in used),
        rejected=tuple(rejected),
        findings=(*checked.findings, *left_out_findings(pairs.names, [pairs.names[i] for i in used], rejected)),
        n_iterations=len(used),
        provenance={"rectangles": _document(prior.rig, pairs, solves, used)},
    )


def _rejected(pairs: RectanglePairs, solves: Sequence[PairSolve | None]) -> list[RejectedView]:
    rejected = []
    for name, solve in zip(pairs.names, solves, strict=True):
        if solve is None:
            rejected.append(RejectedView(name, "its corners are no rectangle before both cameras at any distance"))
        elif not is_fitting(solve):
            off = np.sqrt(solve.chi2 / solve.freedom)
            rejected.append(
                RejectedView(
                    name,
                    f"corners, attitude and rectangle miss each other by {off:.1f} times what their standard deviations allow: corners "
                    "of another rectangle, a rectangle that moved, or an attitude that is off by more than stated",
                )
            )
    return rejected


def _covariance(
    prior: RigPrior,
    pairs: RectanglePairs,
    noise_px: float,
    solves: Sequence[PairSolve | None],
    last: int,
    request: CalibrationRequest,
) -> Covariance:
    """Of the intrinsics, as the prior has them, and of the pose: the last pair's own, and what the prior's errors make of it."""
    names, P = prior.names, np.linalg.inv(prior.information) if prior.names else np.zeros((0, 0))
    values, vectors = np.linalg.eigh(P) if len(P) else (np.zeros(0), np.zeros((0, 0)))
    up_to = pairs.select(range(last + 1))
    solve = solves[last]
    assert solve is not None  # it is used
    by_prior = np.zeros((6, len(names)))
    T = rig_at(prior.rig, solve.angles_rad)
    for value, direction in zip(values, vectors.T, strict=True):
        step = STEP_SIGMA * np.sqrt(max(value, 1e-300))
        request.check_stop()
        moved_rig = _stepped(prior.rig, names, step * direction)
        moved = follow(moved_rig, up_to, noise_px, solves[: last + 1])[last]
        if moved is None:
            raise NotConvergedError("the last pair has no solution within a tenth of the prior's standard deviations.")
        there = rig_at(moved_rig, moved.angles_rad)
        shift = np.r_[so3.log(there.R @ T.R.T), there.t - T.t] / step
        by_prior += np.outer(shift, direction)
    of_angles = rig_by_angles(prior.rig, solve.angles_rad)
    own = of_angles @ solve.covariance[:4, :4] @ of_angles.T
    kept = [i for i, name in enumerate(names) if name.startswith(("left.", "right."))]
    J = np.concatenate([np.eye(len(names))[kept], by_prior])
    matrix = J @ P @ J.T
    matrix[-6:, -6:] += own
    pose = [f"{part}.{axis}" for part in ("rotation", "translation") for axis in "xyz"]
    return Covariance((*(names[i] for i in kept), *pose), 0.5 * (matrix + matrix.T))


def _stepped(rig: StereoRig, names: Sequence[str], step: Float[ndarray, "p"]) -> StereoRig:
    """The rig with parameters moved, in the coordinates of a covariance."""
    moved = dict(zip(names, step.tolist(), strict=True))
    cameras = []
    for side in ("left", "right"):
        camera: Camera = getattr(rig, side)
        away = [moved.get(f"{side}.{name}", 0.0) for name in camera_model(camera.model).parameter_names]
        cameras.append(replace(camera, parameters=camera.parameters + away))
    turn, shift = (
        np.array([moved.get(f"{part}.{axis}", 0.0) for axis in "xyz"]) for part in ("rotation", "translation")
    )
    T = rig.T_right_left
    return StereoRig(cameras[0], cameras[1], SE3(so3.exp(turn) @ T.R, T.t + shift), rig.is_metric)


def _rms(solves: Sequence[PairSolve | None]) -> ResidualSummary:
    lengths2 = np.stack([np.square(s.residuals_px).sum(axis=-1) for s in solves if s is not None])
    left, right = np.sqrt(lengths2.mean(axis=(0, 2))).tolist()
    return ResidualSummary(left, right, float(np.sqrt(lengths2.mean())))


def _view(name: str, solve: PairSolve | None) -> ViewResult:
    assert solve is not None  # it is used
    rms = _rms([solve])
    return ViewResult(name, rms.all_px, rms.left_px, rms.right_px, 8)


def _document(
    rig: StereoRig, pairs: RectanglePairs, solves: Sequence[PairSolve | None], used: Sequence[int]
) -> dict[str, Any]:
    """The rig as it was in each pair: what an on-line user would have had then."""
    rows = []
    for i in used:
        solve = solves[i]
        assert solve is not None  # it is used
        T = rig_at(rig, solve.angles_rad)
        sigma = np.degrees(np.sqrt(np.diag(solve.covariance)[:4])).reshape(2, 2)
        rows.append(
            {
                "name": pairs.names[i],
                "yaw_pitch_deg": {
                    side: np.degrees(a).tolist() for side, a in zip(SIDES, solve.angles_rad, strict=True)
                },
                "sigma_deg": {side: s.tolist() for side, s in zip(SIDES, sigma, strict=True)},
                "R": T.R.tolist(),
                "T": T.t.tolist(),
                "rectangle_m": solve.rectangle.size_m.tolist(),
            }
        )
    return {"pairs": rows}
