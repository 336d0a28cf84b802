"""``rectangles``: cameras that turn in yaw and pitch, followed on line by one rectangle of unknown size per pair.

Known are both cameras and the pose between them before they turned (the prior); an attitude sensor says roughly how each has turned.
Each pair is solved as it comes (:mod:`binocal.solvers.turning_cameras`), and what it says of its rectangle is kept for the next pair
that shows the same one. The rig is that of the last pair; the others are in the provenance.

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

from binocal.calibrators.base import CalibrationRequest
from binocal.calibrators.registry import refuse_unsuited
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.errors import NotConvergedError
from binocal.evidence.rectangles import RectanglePairs
from binocal.findings import finding, refusal
from binocal.geometry import SE3, so3
from binocal.result import Covariance, RejectedView, ResidualSummary, StereoCalibration, ViewResult
from binocal.shapes import Float
from binocal.solvers.prior import RigPrior
from binocal.solvers.turning_cameras import PairSolve, Rectangle, rig_at, rig_by_angles, solve_pair

NAME = "rectangles"
SIDES = ("left", "right")
ASSUMED_NOISE_PX = 0.3  # of a corner, to begin with
NOISE_ROUNDS = 3
LEAST_NOISE_PX = 1e-3
MOST_CHI2 = 8.0  # over the freedom: a pair beyond does not show what it should; the worst of 1200 good ones had 2.9
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
    noise_px = float(stated or ASSUMED_NOISE_PX)
    solves = follow(prior.rig, pairs, noise_px)
    for _ in range(0 if stated else NOISE_ROUNDS):
        request.check_stop()
        noise_px = _noise_px(solves)
        solves = follow(prior.rig, pairs, noise_px, solves)
    request.check_stop()
    used = [i for i, solve in enumerate(solves) if solve is not None and _fits(solve)]
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
        n_iterations=len(used),
        provenance={"rectangles": _document(prior.rig, pairs, solves, used)},
    )


def follow(
    rig: StereoRig, pairs: RectanglePairs, noise_px: float, near: Sequence[PairSolve | None] = ()
) -> list[PairSolve | None]:
    """Every pair solved in its turn, each rectangle known from the pairs before; None where a pair has no solution.

    A pair that does not fit says nothing of its rectangle. ``near`` are solves of nearly the same pairs to start from.
    """
    known: dict[int, Rectangle] = {}
    solves: list[PairSolve | None] = []
    for i, number in enumerate(pairs.rectangle.tolist()):
        solve = solve_pair(
            rig,
            np.stack([pairs.left_px[i], pairs.right_px[i]]),
            np.stack([pairs.left_attitude_rad[i], pairs.right_attitude_rad[i]]),
            float(pairs.attitude_sigma_rad[i]),
            noise_px,
            known.get(number),
            near[i] if near else None,
        )
        solves.append(solve)
        if solve is not None and _fits(solve):
            known[number] = solve.rectangle
    return solves


def _fits(solve: PairSolve) -> bool:
    return solve.chi2 < MOST_CHI2 * solve.freedom


def _noise_px(solves: Sequence[PairSolve | None]) -> float:
    """Standard deviation of a coordinate from what all pairs leave; their median, so that a bad pair has no say."""
    ratios = [float(np.sum(s.residuals_px**2)) / s.pixel_freedom for s in solves if s is not None]
    if not ratios:
        return ASSUMED_NOISE_PX
    good = [
        s
        for s, ratio in zip((s for s in solves if s is not None), ratios, strict=True)
        if ratio < 9 * np.median(ratios)
    ]
    total = sum(float(np.sum(s.residuals_px**2)) for s in good) / sum(s.pixel_freedom for s in good)
    return max(float(np.sqrt(total)), LEAST_NOISE_PX)


def _rejected(pairs: RectanglePairs, solves: Sequence[PairSolve | None]) -> list[RejectedView]:
    rejected = []
    for name, solve in zip(pairs.names, solves, strict=True):
        if solve is None:
            rejected.append(RejectedView(name, "its corners are no rectangle before both cameras at any distance"))
        elif not _fits(solve):
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
    up_to = _first(pairs, last + 1)
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


def _first(pairs: RectanglePairs, n: int) -> RectanglePairs:
    return RectanglePairs(
        pairs.left_px[:n],
        pairs.right_px[:n],
        pairs.left_attitude_rad[:n],
        pairs.right_attitude_rad[:n],
        pairs.attitude_sigma_rad[:n],
        pairs.rectangle[:n],
        pairs.names[:n],
    )


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
