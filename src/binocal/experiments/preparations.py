"""What the paper's filter and stronger edges do to corners, at several levels of noise and of light."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.evidence import Detections
from binocal.experiments.boards import FILL, LOOKS, MODEL
from binocal.experiments.case import Case, Made, Sample
from binocal.experiments.rendered import RenderedFiles, render_files
from binocal.experiments.row import Measured
from binocal.images.preprocessing import Preparation
from binocal.metrics.pose import compare_with_truth
from binocal.shapes import Float
from binocal.simulation import PoseOptions, StereoScene, sample_board_poses, table2_rig

TABLE = "preparation"
SPEC = "chessboard:11x8:20mm"
N_PAIRS = 6
NOISES_DN = (1.0, 3.0, 10.0)
LIGHTS = {"full light": (30.0, 210.0), "dim": (12.0, 48.0), "bright": (150.0, 245.0)}
"""Grey levels of ink and of paper."""
BEYOND_PX = 1.0  # a corner so far off is a wrong one and is counted, not averaged


@dataclass(frozen=True, slots=True)
class LitImages:
    """Rendered pairs at a level of noise and light. The same poses at every level."""

    noise_dn: float
    black_dn: float
    white_dn: float

    def __call__(self, seed: int) -> Sample:
        """See :class:`binocal.experiments.case.Case`."""
        rng, rig, board = np.random.default_rng([seed, 14]), table2_rig(), parse_board(SPEC)
        scene = StereoScene(rig, board, sample_board_poses(rig, board, N_PAIRS, rng, PoseOptions(fill=FILL)))
        looks = replace(LOOKS, noise_dn=self.noise_dn, black_dn=self.black_dn, white_dn=self.white_dn)
        return Sample(
            render_files(scene, looks, np.random.SeedSequence([seed, 15])), rig, board, choices={"model": MODEL}
        )


@dataclass(frozen=True, slots=True)
class Prepared:
    """Corners measured in images prepared so, and a calibration from them."""

    label: str
    preparation: Preparation

    def __call__(self, sample: Sample) -> tuple[Made, ...]:
        """See :class:`binocal.experiments.case.Method`."""
        files: RenderedFiles = sample.evidence
        corners = files.corners(self.preparation)
        made = calibrate(corners, calibrator="lm", **sample.choices)
        return (Made(made.rig, made, corner_figures(files, corners)),)


def corner_figures(files: RenderedFiles, corners: Detections) -> dict[str, tuple[float, str]]:
    """How far corners lie from the truth, and how many of those in the images were found."""
    places = [int(name) for name in corners.names]
    errors, n_true = [], 0
    for exact, found in zip(files.exact_px(), (corners.left_px, corners.right_px), strict=True):
        n_true += int(np.isfinite(exact[..., 0]).sum())
        errors.append((found - exact[places]).reshape(-1, 2))
    error = np.concatenate(errors)
    size = np.hypot(*error[np.isfinite(error[:, 0])].T)
    right = size < BEYOND_PX
    return {
        "corner error": (_coordinate_rms(size[right]), "px"),
        "corners found": (100 * float(right.sum()) / n_true, "%"),
        "wrong corners": (float((~right).sum()), ""),
    }


def _coordinate_rms(size: Float[ndarray, "k"]) -> float:
    return float(np.sqrt(np.mean(size**2) / 2)) if size.size else np.nan


def preparation_errors(made: Made, sample: Sample) -> list[Measured]:
    """What the corners came to, and the rig that they gave."""
    truth = compare_with_truth(made.rig, sample.truth, has_skew=False)
    assert made.calibration is not None  # these methods calibrate
    return [
        *(Measured(name, unit, value) for name, (value, unit) in made.said.items()),
        Measured("stated noise", "px", made.calibration.noise_px),
        Measured("rotation error", "deg", truth.rotation_error_deg),
        Measured("translation error", "mm", truth.translation_error_mm),
    ]


def preparation_cases() -> list[Case]:
    """Each noise in full light, and each light with the middle noise."""
    methods = (
        Prepared("as recorded", Preparation()),
        Prepared("filtered, edges strengthened", Preparation(strengthens=True)),
    )
    levels = [(noise, "full light") for noise in NOISES_DN] + [
        (NOISES_DN[1], light) for light in LIGHTS if light != "full light"
    ]
    return [
        Case(f"noise {noise:g}, {light}", LitImages(noise, *LIGHTS[light]), preparation_errors, methods, table=TABLE)
        for noise, light in levels
    ]
