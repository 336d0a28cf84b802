"""Detections as a detector would return them: exact projections, then noise, outliers, missing corners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy import ndarray

from binocal.evidence import Detections
from binocal.shapes import Float
from binocal.simulation.scenes import StereoScene


def simulate_detections(
    scene: StereoScene,
    rng: np.random.Generator,
    *,
    noise_px: float = 0.0,
    outlier_share: float = 0.0,
    outlier_px: float = 5.0,
    missing_share: float = 0.0,
) -> Detections:
    """Corners of every view in both cameras.

    ``noise_px`` is the standard deviation of each coordinate (Gaussian, independent). ``outlier_share`` of the seen
    corners of each camera are moved by ``outlier_px`` in a random direction; ``missing_share`` of them are NaN.
    Points outside an image are NaN. The same generator state draws the same noise whatever the shares are.

    Raises:
        ValueError: A share is outside [0, 1], or a standard deviation is negative.
    """
    if not noise_px >= 0:
        raise ValueError(f"noise_px must be 0 or more; got {noise_px}")
    left, right = scene.project()
    draws = rng.standard_normal((2, *left.shape))
    detections = Detections.from_arrays(
        scene.board.object_points_m,
        left + noise_px * draws[0],
        right + noise_px * draws[1],
        scene.rig.left.size_wh,
        right_image_size_wh=scene.rig.right.size_wh,
        is_metric=scene.board.is_metric,
    )
    if outlier_share:
        detections = add_outliers(detections, rng, share=outlier_share, distance_px=outlier_px)
    if missing_share:
        detections = drop_corners(detections, rng, share=missing_share)
    return detections


def scatter_corners(
    detections: Detections,
    rng: np.random.Generator,
    left_covariance_px2: Float[ndarray, "views n 2 2"],
    right_covariance_px2: Float[ndarray, "views n 2 2"],
) -> Detections:
    """Moves every corner by Gaussian noise of its own covariance, and states that covariance."""
    moved = []
    for px, covariance in (
        (detections.left_px, left_covariance_px2),
        (detections.right_px, right_covariance_px2),
    ):
        moved.append(px + (np.linalg.cholesky(covariance) @ rng.standard_normal((*px.shape, 1)))[..., 0])
    return replace(
        detections,
        left_px=moved[0],
        right_px=moved[1],
        left_covariance_px2=left_covariance_px2,
        right_covariance_px2=right_covariance_px2,
    )


def add_outliers(detections: Detections, rng: np.random.Generator, *, share: float, distance_px: float) -> Detections:
    """Moves that share of each camera's seen corners (a whole number of them) by ``distance_px``, each its own way."""

    def move(px: Float[ndarray, "views n 2"]) -> Float[ndarray, "views n 2"]:
        picked = _pick(px, rng, share)
        angle = rng.uniform(0, 2 * np.pi, len(picked))
        out = px.copy()
        out.reshape(-1, 2)[picked] += distance_px * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return out

    return replace(detections, left_px=move(detections.left_px), right_px=move(detections.right_px))


def drop_corners(detections: Detections, rng: np.random.Generator, *, share: float) -> Detections:
    """Makes that share of each camera's seen corners (rounded to a whole number of corners) NaN."""

    def drop(px: Float[ndarray, "views n 2"]) -> Float[ndarray, "views n 2"]:
        out = px.copy()
        out.reshape(-1, 2)[_pick(px, rng, share)] = np.nan
        return out

    return replace(detections, left_px=drop(detections.left_px), right_px=drop(detections.right_px))


def _pick(px: Float[ndarray, "views n 2"], rng: np.random.Generator, share: float) -> ndarray:
    """Flat indices of a random share of the seen corners."""
    if not 0 <= share <= 1:
        raise ValueError(f"a share must be within 0 and 1; got {share}")
    seen = np.flatnonzero(np.isfinite(px[..., 0]))
    return rng.permutation(seen)[: round(share * seen.size)]
