"""The pose from matches without a board: errors over the Cramér-Rao bound of the right ones, coverage, wrong minima, untold scenes.

Simulated matches of streets, rooms, far scenes and planes, wrong ones of every kind; cameras are exact. The old rig that is given is 5
degrees off in rotation and in direction. OpenCV's MAGSAC with ``recoverPose`` has the same matches.
"""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.calibrators.natural import NaturalRequest, calibrate_from_matches
from binocal.cameras import Camera, StereoRig
from binocal.errors import CalibrationError
from binocal.geometry import SE3, so3
from binocal.matching.relative_pose import estimate_relative_pose
from binocal.result import Covariance, StereoCalibration
from binocal.shapes import Float
from binocal.simulation import MatchDistribution, SimulatedMatches, sample_match_problems, simulate_matches
from binocal.solvers.epipolar import EpipolarProblem
from binocal.solvers.epipolar_descent import NEAR_PX, finish
from binocal.solvers.portfolio import PORTFOLIO, compete
from binocal.solvers.relative_pose import RelativePose, tangents

FEW_WRONG = MatchDistribution(noise_px=(0.06, 0.3), n_matches=(200, 500))
MANY_WRONG = MatchDistribution(noise_px=(0.2, 1.0), n_matches=(100, 300))
SHARES: tuple[tuple[MatchDistribution, tuple[float, float]], ...] = (
    (FEW_WRONG, (0.0, 0.0)),
    (FEW_WRONG, (0.15, 0.15)),
    (FEW_WRONG, (0.4, 0.4)),
    (MANY_WRONG, (0.5, 0.65)),
    (MANY_WRONG, (0.65, 0.85)),
)
METHODS = ("binocal", "without_agent", "portfolio", "from_truth", "opencv")
START_OFF_DEG, KEPT_OFF_DEG = 5.0, 1.0
LEAST_NEAR = 8  # matches within a few pixels, for an end to be looked at
FOUND = 3.0
"""Standard deviations of the bound, RMS over the five unknowns, from the truth or from where a start at the truth ends: the right
minimum. Wrong matches near their epipolar lines move it, and no method can tell."""
EXACT = Covariance(("left.fx",), np.zeros((1, 1)))  # a rig file that calls its cameras exact


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """A simulated problem, the old rig, and the information that the right matches have at the truth."""

    drawn: SimulatedMatches
    old: SE3
    information: Float[ndarray, "5 5"]

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        return self.drawn.rig.left, self.drawn.rig.right

    @property
    def truth(self) -> RelativePose:
        return RelativePose.of(self.drawn.rig.T_right_left)

    def ratio(self, found: RelativePose, from_pose: RelativePose | None = None) -> float:
        """Error, or difference, over the bound, RMS of the five unknowns; of the direction without its sign."""
        other = self.truth if from_pose is None else from_pose
        error = other.step_to(found)
        return float(np.sqrt(error @ self.information @ error / 5))


def run_natural_benchmark(*, n_problems: int = 200, n_untold: int = 50, seed: int = 0) -> dict[str, Any]:
    """``n_problems`` of each share of wrong matches, ``n_untold`` of each kind of scene that does not tell the pose."""
    rows = []
    for index, (distribution, share) in enumerate(SHARES):
        rng = np.random.default_rng([seed, index])
        rows.append({"wrong_share": list(share)} | _run_share(distribution, share, n_problems, rng))
    untold = [_run_untold(name, n_untold, np.random.default_rng([seed, 100 + i])) for i, name in enumerate(UNTOLD)]
    machine = f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}"
    return {
        "benchmark": "natural",
        "n_problems": n_problems,
        "seed": seed,
        "machine": machine,
        "rows": rows,
        "untold": untold,
        "text": _format(rows, untold, n_problems, machine),
    }


def _run_share(
    distribution: MatchDistribution, share: tuple[float, float], n_problems: int, rng: np.random.Generator
) -> dict[str, Any]:
    """Ratios to the bound of all methods on one distribution, and how often the stated standard deviations hold."""
    batch = sample_match_problems(replace(distribution, wrong_share=share), n_problems, rng)
    scores: dict[str, list[tuple[float, bool]]] = {name: [] for name in METHODS}
    standardised: list[Float[ndarray, "5"]] = []
    n_refused = n_kept = 0
    for index in range(n_problems):
        problem = _posed(batch.problem(index), rng)
        calibration = _calibrate(problem, problem.old)
        is_told = _told(calibration) is not None
        n_refused += calibration is None
        n_kept += calibration is not None and not is_told
        poses = _peers(problem)
        poses["binocal"] = _told(calibration)
        poses["without_agent"] = _told(_calibrate(problem, problem.old, "portfolio"))
        for name, pose in poses.items():
            scores[name].append(_score(problem, pose, poses["from_truth"]))
        if calibration is not None and is_told:
            standardised.append(_standardised(calibration, problem.truth))
    z = np.abs(np.concatenate(standardised)) if standardised else np.zeros(0)
    return {name: _summary(values) for name, values in scores.items()} | {
        "refused": n_refused,
        "kept": n_kept,
        "within_1_sigma": float(np.mean(z < 1)),
        "within_2_sigma": float(np.mean(z < 2)),
    }


def _peers(problem: _Problem) -> dict[str, RelativePose | None]:
    """What the other methods make of the same matches."""
    matches = problem.drawn.matches
    equations, _ = EpipolarProblem.of_matches(problem.cameras, matches)
    best = compete(equations, RelativePose.of(problem.old), PORTFOLIO).estimate
    peer = estimate_relative_pose(problem.cameras, matches.left_px, matches.right_px)
    return {
        "portfolio": _finished(equations, best),
        "from_truth": _finished(equations, problem.truth),
        "opencv": None if peer is None else RelativePose.of(peer),
    }


def _finished(equations: EpipolarProblem, end: RelativePose) -> RelativePose | None:
    """The minimum there; None where hardly a match is near."""
    is_near = np.abs(equations.residuals_px(end)) < NEAR_PX
    return finish(equations, end).estimate if is_near.sum() >= LEAST_NEAR else None


def _score(problem: _Problem, pose: RelativePose | None, reference: RelativePose | None) -> tuple[float, bool]:
    """Error over the bound, NaN without a result, and whether it is in the right minimum."""
    if pose is None:
        return float("nan"), False
    ratio = problem.ratio(pose)
    return ratio, min(ratio, problem.ratio(pose, reference)) < FOUND


def _posed(drawn: SimulatedMatches, rng: np.random.Generator, off_deg: float = START_OFF_DEG) -> _Problem:
    """A problem with an old rig off by so much in rotation, about any axis, and in direction."""
    cameras = drawn.rig.left, drawn.rig.right
    truth = RelativePose.of(drawn.rig.T_right_left)
    right, _ = EpipolarProblem.of_matches(cameras, drawn.matches.select(drawn.is_right))
    information = right.linearize(truth, np.asarray(1.0), "squared").information / drawn.noise_px**2
    turn, way = rng.standard_normal(3), rng.standard_normal(2)
    xi = np.r_[turn / np.linalg.norm(turn), way / np.linalg.norm(way)] * np.radians(off_deg)
    old = truth.stepped(xi)
    return _Problem(drawn, SE3(so3.project_to_rotation(old.R), drawn.rig.baseline_m * old.t), information)


def _told(calibration: StereoCalibration | None) -> RelativePose | None:
    """The pose, where there is one and the matches tell all of it."""
    if calibration is None or _is_kept(calibration):
        return None
    return RelativePose.of(calibration.rig.T_right_left)


def _calibrate(problem: _Problem, old: SE3 | None, calibrator: str = "drl") -> StereoCalibration | None:
    """As ``recalibrate`` does from matches; None where they are refused."""
    request = NaturalRequest(
        problem.cameras,
        old,
        problem.drawn.rig.baseline_m,
        intrinsics=EXACT,
        guess=lambda found: estimate_relative_pose(problem.cameras, found.left_px, found.right_px),
        calibrator=calibrator,
    )
    try:
        return calibrate_from_matches(problem.drawn.matches, request)
    except CalibrationError:
        return None


def _is_kept(calibration: StereoCalibration) -> bool:
    return any(found.code == "scene-tells-too-little-kept" for found in calibration.findings)


def _standardised(calibration: StereoCalibration, truth: RelativePose) -> Float[ndarray, "5"]:
    """Errors of the five unknowns over their stated standard deviations."""
    found = RelativePose.of(calibration.rig.T_right_left)
    across = np.cross(tangents(found.t).T, found.t)  # where a turn about each axis moves the direction
    covariance = across @ calibration.covariance.block("translation") @ across.T / calibration.rig.baseline_m**2
    variances = np.r_[np.diagonal(calibration.covariance.block("rotation")), np.diagonal(covariance)]
    if found.t @ truth.t < 0:
        return np.full(5, np.inf)
    return found.step_to(truth) / np.sqrt(variances)


def _summary(scores: Sequence[tuple[float, bool]]) -> dict[str, float]:
    """Of what was told: the median over the bound, the RMS where the right minimum was found; the share found of all."""
    ratios, is_found = np.array(scores).T
    is_found = is_found > 0
    return {
        "median": float(np.nanmedian(ratios)) if np.isfinite(ratios).any() else float("nan"),
        "rms": float(np.sqrt(np.mean(ratios[is_found] ** 2))) if is_found.any() else float("nan"),
        "found_share": float(is_found.mean()),
    }


def _far_away(rng: np.random.Generator) -> SimulatedMatches:
    return simulate_matches(_rig(rng, 800.0, 1e-5), 400, rng, family="far", noise_px=0.1)


def _on_one_row(rng: np.random.Generator) -> SimulatedMatches:
    found = simulate_matches(_rig(rng, 800.0, 0.4), 100_000, rng, family="street", noise_px=0.3)
    return _only(found, np.abs(found.matches.left_px[:, 1] - 240.0) < 0.5)


def _narrow(rng: np.random.Generator) -> SimulatedMatches:
    """A field of 0.4 degrees."""
    return simulate_matches(_rig(rng, 100_000.0, 0.1), 150, rng, family="far", noise_px=0.3)


def _only(found: SimulatedMatches, index: ndarray) -> SimulatedMatches:
    return SimulatedMatches(found.rig, found.matches.select(index), found.is_right[index], found.noise_px)


def _rig(rng: np.random.Generator, focal_px: float, baseline_m: float) -> StereoRig:
    camera = Camera("brown4", (640, 480), np.array([focal_px, focal_px, 320, 240, 0, 0, 0, 0, 0]))
    most_rad = np.radians(2.0) * min(1.0, 800.0 / focal_px)  # both see the same
    t = baseline_m * np.array([-1.0, *rng.uniform(-0.05, 0.05, 2)])
    return StereoRig(camera, camera, SE3(so3.exp(rng.uniform(-1, 1, 3) * most_rad), t))


UNTOLD = {"all points far away": _far_away, "no vertical spread": _on_one_row, "narrow field": _narrow}
"""Scenes that do not tell the whole pose."""


def _run_untold(name: str, n: int, rng: np.random.Generator) -> dict[str, Any]:
    """How often a scene is refused without an old rig, and its untold part kept by name with one; errors of what was kept.

    The old rig is off by a degree in rotation and direction: the standard deviation that kept angles get.
    """
    refused = kept = 0
    standardised: list[Float[ndarray, "5"]] = []
    for _ in range(n):
        problem = _posed(UNTOLD[name](rng), rng, KEPT_OFF_DEG)
        refused += _calibrate(problem, None) is None
        with_old = _calibrate(problem, problem.old)
        kept += with_old is None or _is_kept(with_old)
        if with_old is not None:
            standardised.append(_standardised(with_old, problem.truth))
    z = np.abs(np.concatenate(standardised)) if standardised else np.zeros(0)
    return {
        "scene": name,
        "n": n,
        "refused_without_old_rig": refused,
        "kept_or_refused_with_old_rig": kept,
        "kept_within_3_sigma": float(np.mean(z < 3)) if z.size else float("nan"),
    }


def _format(rows: Sequence[dict[str, Any]], untold: Sequence[dict[str, Any]], n_problems: int, machine: str) -> str:
    lines = [
        f"{n_problems} problems a row, start {START_OFF_DEG:g} deg off: error over the bound, median / rms, and found ({machine})",
        "| wrong | binocal | without the agent | 4 schedules | from the truth | MAGSAC | kept, refused | within 1, 2 sigma |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        low, high = row["wrong_share"]
        wrong = f"{100 * low:.0f} %" if low == high else f"{100 * low:.0f}-{100 * high:.0f} %"
        cells = [
            f"{row[name]['median']:.2f} / {row[name]['rms']:.2f}, {100 * row[name]['found_share']:.1f} %"
            for name in METHODS
        ]
        covered = f"{100 * row['within_1_sigma']:.1f}, {100 * row['within_2_sigma']:.1f} %"
        lines.append(f"| {wrong} | {' | '.join(cells)} | {row['kept']}, {row['refused']} | {covered} |")
    lines += [
        "",
        "| scene | refused without an old rig | kept or refused with one | errors within 3 sigma |",
        "|---|---|---|---|",
    ]
    for row in untold:
        n, refused, kept = (row[key] for key in ("n", "refused_without_old_rig", "kept_or_refused_with_old_rig"))
        inside = f"{100 * row['kept_within_3_sigma']:.0f} %"
        lines.append(f"| {row['scene']} | {refused} of {n} | {kept} of {n} | {inside} |")
    return "\n".join(lines)
