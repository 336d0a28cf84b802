"""How far a rig from natural images is from another one, with the standard deviations that such a difference has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.errors import DataError
from binocal.geometry import SE3, so3
from binocal.result import Covariance, StereoCalibration
from binocal.shapes import Float

DRIFT_SIGMAS = 4.0  # twelve regions of one pair leave heavier tails than a normal's 3
DEPTHS_M = (1.0, 5.0, 20.0)
ANGLES = ("pitch", "yaw", "roll")
MADE_OF = {"random_rotation_covariance_rad2", "random_direction_covariance", "pair_scatter_rad2", "n_matches"}
"""What the provenance of a result of ``recalibrate`` holds, and no other's."""
AGAINST_RIG, AGAINST_REFERENCE = "the rig as given", "the file's own reference"
LENGTH_TOLERANCE = 1e-6
PAIR_SCATTER_DEG = np.array([0.012, 0.012, 0.012])
"""By which single pairs differ beside the errors of their matches, at the least: KITTI's grey frames and BumbleBee2 scenes do, in pitch."""


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """The turn from one rig to another, with standard deviations where they are one.

    ``turn_deg`` is what the right camera was turned by about its own x, y and z, as pitch, yaw and roll of a rig are
    (docs/conventions.md). ``direction_sigma_deg`` is that of the angle between the directions of the translation; NaN where it is
    not known.
    """

    turn_deg: Float[ndarray, "3"]
    sigma_deg: Float[ndarray, "3"]
    direction_deg: float
    against: str
    direction_sigma_deg: float = float("nan")

    @property
    def z(self) -> Float[ndarray, "3"]:
        """Turns over their standard deviations."""
        return self.turn_deg / np.maximum(self.sigma_deg, 1e-12)

    @property
    def direction_z(self) -> float:
        """The same for the direction of the translation; 0 where its standard deviation is not known."""
        known = np.isfinite(self.direction_sigma_deg)
        return float(self.direction_deg / max(self.direction_sigma_deg, 1e-12)) if known else 0.0

    @property
    def is_sure(self) -> bool:
        """Whether the rig has turned, or its translation points elsewhere."""
        return bool(max(np.abs(self.z).max(), self.direction_z) > DRIFT_SIGMAS)


def turn_between(R_from: Float[ndarray, "3 3"], R_to: Float[ndarray, "3 3"]) -> Float[ndarray, "3"]:
    """What the right camera is turned by from one rotation (right from left) to another, degrees about its own axes."""
    return np.degrees(so3.log(R_from @ R_to.T))


def depth_error_percent(rig: StereoRig, drift: Drift) -> dict[str, float]:
    """What a drift in yaw does to depth, percent, by distance in metres; empty without a length."""
    if not rig.is_metric:
        return {}
    yaw = np.radians(abs(float(drift.turn_deg[1])))
    return {f"{z:g}": float(100 * z * yaw / rig.baseline_m) for z in DEPTHS_M}


def drift_of(
    calibration: StereoCalibration,
    rig: StereoRig,
    known: Covariance | None,
    reference: Mapping[str, Any] | None,
    made: Mapping[str, Any] | None = None,
) -> Drift:
    """Against the reference, whose intrinsics are the same, what matches and pairs differ by counts; against the rig, all of it.

    ``made``: the reference document of a rig that is itself a result of ``recalibrate``. Its pose bears the errors of the same
    intrinsics, which count once, to the extent that the scenes tell them differently; how single pairs differ counts too.
    """
    T = calibration.rig.T_right_left
    unit = T.t / np.linalg.norm(T.t)
    own = calibration.provenance
    random = np.array(own["random_rotation_covariance_rad2"])
    if reference is not None:
        R, t, of_reference = reference_values(reference)
        covariance = random + of_reference + _pair_scatter(calibration, reference)
        of_direction = None
        if "random_direction_covariance" in reference:
            stated = _values(reference, "random_direction_covariance", (3, 3))
            of_direction = np.array(own["random_direction_covariance"]) + stated
        against = AGAINST_REFERENCE
    else:
        R, t = rig.T_right_left.R, rig.T_right_left.t
        covariance, against = calibration.covariance.block("rotation"), AGAINST_RIG
        of_direction = _direction_covariance(calibration.rig, calibration.covariance)
        if known is not None and "rotation.x" in known.names:
            covariance = covariance + known.block("rotation")
            of_direction = of_direction + _direction_covariance(rig, known)
        if known is not None and made is not None:
            in_common = covariance_in_common(calibration.covariance, known)
            across = _across(calibration.rig) @ in_common[3:, 3:] @ _across(rig).T
            covariance = _no_less(covariance - in_common[:3, :3] - in_common[:3, :3].T, random)
            covariance = covariance + _pair_scatter(calibration, made)
            of_direction = _no_less(of_direction - across - across.T, np.array(own["random_direction_covariance"]))
    sigma = np.degrees(np.sqrt(np.diagonal(covariance)))
    other = t / np.linalg.norm(t)
    direction = float(np.degrees(np.arccos(np.clip(unit @ other, -1, 1))))
    return Drift(turn_between(R, T.R), sigma, direction, against, _direction_sigma_deg(unit, other, of_direction))


def covariance_in_common(new: Covariance, old: Covariance) -> Float[ndarray, "6 6"]:
    """Covariance of one estimate's rotation and translation with the other's: both bear the errors of the same intrinsics.

    Both hold the covariance of their pose with the intrinsics, K; that of the intrinsics, C, is the same: K_new C⁻¹ K_oldᵀ.
    """
    pose = [f"{part}.{axis}" for part in ("rotation", "translation") for axis in "xyz"]
    names = [name for name in new.names if name in old.names and name.startswith(("left.", "right."))]
    if not names or not set(pose) <= set(new.names) & set(old.names):
        return np.zeros((6, 6))
    place = [[covariance.names.index(name) for name in names] for covariance in (new, old)]
    rows = [[covariance.names.index(name) for name in pose] for covariance in (new, old)]
    C = old.matrix[np.ix_(place[1], place[1])]
    size = np.sqrt(np.maximum(np.diagonal(C), 1e-300))
    inverse = np.linalg.pinv(C / np.outer(size, size), rcond=1e-9, hermitian=True)
    K_new, K_old = (c.matrix[np.ix_(r, p)] / size for c, r, p in zip((new, old), rows, place, strict=True))
    in_common: Float[ndarray, "6 6"] = K_new @ inverse @ K_old.T
    return in_common


def _no_less(covariance: Float[ndarray, "3 3"], least: Float[ndarray, "3 3"]) -> Float[ndarray, "3 3"]:
    """With no variance below that of ``least``: what is in common is subtracted, and rounding may leave nothing."""
    short = np.maximum(np.diagonal(least) - np.diagonal(covariance), 0.0)
    return covariance + np.diag(short)


def _pair_scatter(calibration: StereoCalibration, other: Mapping[str, Any]) -> Float[ndarray, "3 3"]:
    """Of the rotation, by how single pairs differ beside their matches: those of this calibration and those of the other."""
    scatter = np.maximum.reduce(
        [
            np.radians(PAIR_SCATTER_DEG) ** 2,
            calibration.provenance["pair_scatter_rad2"],
            _values(other, "pair_scatter_rad2", (3,)),
        ]
    )
    pairs = 1 / max(len(calibration.views), 1) + 1 / max(len(other.get("pairs", ())), 1)
    return np.diag(scatter * pairs)


def _values(reference: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> ndarray:
    """An entry that references of before do not have, which count as 0."""
    try:
        values = np.asarray(reference.get(key, np.zeros(shape)), dtype=float)
    except (TypeError, ValueError):
        values = np.full(1, np.nan)
    if values.shape != shape or not np.isfinite(values).all():
        raise _damaged(f"{key} is not {' x '.join(map(str, shape))} finite numbers")
    return values


def _direction_covariance(rig: StereoRig, covariance: Covariance) -> Float[ndarray, "3 3"]:
    """Of the translation's unit vector; 0 where nothing is said of the translation."""
    if "translation.x" not in covariance.names:
        return np.zeros((3, 3))
    return _across(rig) @ covariance.block("translation") @ _across(rig).T


def _across(rig: StereoRig) -> Float[ndarray, "3 3"]:
    """The derivative of the translation's unit vector by the translation."""
    length = rig.baseline_m
    unit = rig.T_right_left.t / length
    return (np.eye(3) - np.outer(unit, unit)) / length


def _direction_sigma_deg(
    unit: Float[ndarray, "3"], other: Float[ndarray, "3"], covariance: Float[ndarray, "3 3"] | None
) -> float:
    """Standard deviation along the way from one direction to the other."""
    if covariance is None:
        return float("nan")
    way = other - unit * (unit @ other)
    length = np.linalg.norm(way)
    if length < 1e-12:
        return float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance)[-1])))
    way = way / length
    return float(np.degrees(np.sqrt(max(way @ covariance @ way, 0.0))))


def made_by_recalibrate(rig: StereoCalibration) -> dict[str, Any] | None:
    """The reference document of a rig that is a result of ``recalibrate``; None of any other."""
    return reference_document(rig) if set(rig.provenance) >= MADE_OF else None


def reference_document(calibration: StereoCalibration) -> dict[str, Any]:
    """What a rig file keeps of its own ``recalibrate``."""
    T = calibration.rig.T_right_left
    return {
        "R": T.R.tolist(),
        "T_direction": (T.t / np.linalg.norm(T.t)).tolist(),
        "random_rotation_covariance_rad2": calibration.provenance["random_rotation_covariance_rad2"],
        "random_direction_covariance": calibration.provenance["random_direction_covariance"],
        "pair_scatter_rad2": calibration.provenance["pair_scatter_rad2"],
        "n_matches": calibration.provenance["n_matches"],
        "pairs": [view.name for view in calibration.views],
    }


def reference_values(document: Any) -> tuple[Float[ndarray, "3 3"], Float[ndarray, "3"], Float[ndarray, "3 3"]]:
    """Rotation, direction and random covariance of a reference.

    Raises:
        DataError: They are none.
    """
    if not isinstance(document, Mapping):
        raise _damaged("it is no object of names and values")
    missing = [key for key in ("R", "T_direction", "random_rotation_covariance_rad2") if key not in document]
    if missing:
        raise _damaged(f"{missing[0]} is missing")
    R, t = _values(document, "R", (3, 3)), _values(document, "T_direction", (3,))
    C = _values(document, "random_rotation_covariance_rad2", (3, 3))
    try:
        SE3(R, t)
    except ValueError:
        raise _damaged("R is no rotation") from None
    if abs(np.linalg.norm(t) - 1) > LENGTH_TOLERANCE:
        raise _damaged("T_direction is not of length 1")
    if not np.allclose(C, C.T, atol=1e-6 * np.abs(C).max()) or np.linalg.eigvalsh(C)[0] <= 0:
        raise _damaged("random_rotation_covariance_rad2 is no covariance")
    if not isinstance(document.get("pairs", []), list):
        raise _damaged("pairs is no list of names")
    return R, t, C


def _damaged(what: str) -> DataError:
    return DataError(
        f"the rig file's reference is damaged: {what}; write it anew with `binocal recalibrate --reference`."
    )
