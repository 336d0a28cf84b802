"""What may have changed of a rig that new images do not agree with: single causes, fitted to the difference in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.cameras import StereoRig
from binocal.requirements.agreement import Cause
from binocal.shapes import Float
from binocal.values import with_sigma

ALONG_BASELINE = 0.99  # cosine; hardly a shift by chance, and what a board of another size looks like
NEARLY = 0.97  # of what the best cause explains: as likely as it


@dataclass(frozen=True, slots=True, eq=False)
class CauseFit:
    """A single cause fitted to the difference: its ``size`` in each of its directions, known to ``spread``, and what it explains.

    ``gain`` is by how much it lowers the statistic, by chance as chi-squared with ``freedom`` degrees of freedom.
    """

    code: str
    size: Float[ndarray, "q"]
    spread: Float[ndarray, "q q"]
    gain: float
    freedom: int


def fit_causes(
    rig: StereoRig, names: tuple[str, ...], forms: Float[ndarray, "k p"], z: Float[ndarray, "k"]
) -> list[CauseFit]:
    """Every single cause, the commoner first, that the views tell anything of."""
    fits: list[CauseFit] = []
    for code, directions in _causes(rig, names).items():
        A = forms @ directions
        if not A.any():
            continue
        size, _, rank, _ = np.linalg.lstsq(A, z, rcond=1e-10)
        gain = max(float(np.sum(z**2) - np.sum((z - A @ size) ** 2)), 0.0)
        fits.append(CauseFit(code, size, np.linalg.pinv(A.T @ A), gain, int(rank)))
    return fits


def likeliest_cause(rig: StereoRig, fits: Sequence[CauseFit], statistic: float) -> Cause | None:
    """The first of the causes that explains nearly as much of the statistic as the best of them.

    A turn of a camera and a shift of its image look alike from the corners; where both would do, the other is said too.
    """
    best = max((fit.gain for fit in fits), default=0.0)
    if not best > 0:
        return None
    likely = [_described(rig, f.code, f.size, f.spread, f.gain / statistic) for f in fits if f.gain > NEARLY * best]
    others = [
        cause for cause in likely[1:] if cause.code.endswith("image shifted") and likely[0].code.endswith("turned")
    ]
    if not others:
        return likely[0]
    return replace(
        likely[0], words=f"{likely[0].words}; a shift of its image by {others[0].size:.2f} px would look the same"
    )


def _causes(rig: StereoRig, names: tuple[str, ...]) -> dict[str, Float[ndarray, "p q"]]:
    """Changes of the parameters by each cause: turns (rad) of a camera about its own centre, a shift of it, focus, its image's shift."""
    index = {name: i for i, name in enumerate(names)}
    R, t = rig.T_right_left.R, rig.T_right_left.t

    def column(values: dict[str, float]) -> Float[ndarray, "p"]:
        out = np.zeros(len(names))
        for name, value in values.items():
            if name in index:
                out[index[name]] = value
        return out

    def motion(turn: Float[ndarray, "3"], shift: Float[ndarray, "3"]) -> Float[ndarray, "p"]:
        values = {f"rotation.{a}": float(v) for a, v in zip("xyz", turn, strict=True)}
        return column(values | {f"translation.{a}": float(v) for a, v in zip("xyz", shift, strict=True)})

    axes = np.eye(3)
    causes = {
        # the right camera turned by w about its centre: R -> exp(w) R, t -> exp(w) t; the left one: R -> R exp(-w)
        "right turned": np.stack([motion(w, np.cross(w, t)) for w in axes], axis=1),
        "left turned": np.stack([motion(-R @ w, np.zeros(3)) for w in axes], axis=1),
        "shifted": np.stack([motion(np.zeros(3), v) for v in axes], axis=1),
    }
    for side in ("left", "right"):
        fx, fy = getattr(rig, side).parameters[:2].tolist()
        causes[f"{side} refocused"] = column({f"{side}.fx": fx, f"{side}.fy": fy})[:, None]
        causes[f"{side} image shifted"] = np.stack([column({f"{side}.cx": 1.0}), column({f"{side}.cy": 1.0})], axis=1)
    return causes


def _described(
    rig: StereoRig, code: str, solution: Float[ndarray, "q"], spread: Float[ndarray, "q q"], share: float
) -> Cause:
    size = float(np.linalg.norm(solution))
    along = solution / max(size, 1e-300)
    sigma = float(np.sqrt(max(along @ spread @ along, 0.0)))
    side, _, what = code.partition(" ")
    other = {"left": "right", "right": "left"}.get(side, "")
    if what == "turned":
        angles = np.degrees(solution)
        parts = ", ".join(f"{name} {a:+.3f} deg" for name, a in zip(("pitch", "yaw", "roll"), angles, strict=True))
        factor = 180 / np.pi
        words = f"the {side} camera (or the {other} one) is turned by {with_sigma(factor * size, factor * sigma)} deg ({parts})"
        return Cause(code, words, factor * size, factor * sigma, "deg", share)
    if code == "shifted":
        unit, factor = rig.printed_unit
        words = f"the cameras are shifted against each other by {with_sigma(factor * size, factor * sigma)} {unit}"
        t = rig.T_right_left.t
        longer = float(along @ t) / float(np.linalg.norm(t))
        if abs(longer) > ALONG_BASELINE:
            percent = 100 * size / float(np.linalg.norm(t))
            change, board = ("longer", "smaller") if longer > 0 else ("shorter", "larger")
            words += f": the baseline is {percent:.2g} % {change}, or the board {board} than its SPEC says by as much"
        return Cause(code, words, size, sigma, "m" if rig.is_metric else unit, share)
    if what == "refocused":
        words = (
            f"the focal length of the {side} camera is another by {with_sigma(100 * solution[0], 100 * sigma)} % (or that of the {other} "
            "one by as much the other way)"
        )
        return Cause(code, words, 100 * size, 100 * sigma, "%", share)
    words = f"the {side} image is shifted by ({solution[0]:+.2f}, {solution[1]:+.2f}) px ± {sigma:.1g}"
    return Cause(code, words, size, sigma, "px", share)
