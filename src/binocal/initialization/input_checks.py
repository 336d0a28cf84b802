"""What one camera's corners, image size and geometry must be before anything is asked of the pair.

Thresholds compare with what the data itself shows (robust medians, covariances), never with one kind of rig.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from binocal.errors import DegenerateGeometryError
from binocal.findings import Finding, finding, refusal
from binocal.geometry.homography import COINCIDENT, COLLINEAR, GOOD, MIN_POINTS, UNFIT, HomographyFit, fit_homographies
from binocal.initialization.intrinsics import InitialCamera
from binocal.initialization.symmetries import transposed_order
from binocal.initialization.vanishing_points import check_orientations
from binocal.shapes import Float

MIN_VIEWS = 3  # two leave the principal point to chance
_OFF_GRID = (
    0.5  # robust sigma of a homography over the corner spacing; 200° fisheyes reach 0.3, a wrong order 1 and more
)
MOST = 0.6  # share of views that makes a fault the set's, not the view's
_OUTSIDE_PX = 2.0
_PLAIN_TILT_RAD = np.radians(15.0)  # that much tilt, in different directions, is plain in the boards' shortening
_UNBENT_SHARE = (
    3e-3  # robust sigma of a homography over the board's size: lenses of 60 degrees and more bend boards further
)
_MAX_SIGMA_LOG_FOCAL = 0.5  # six views tilted by 12° reach 0.37, twenty tilted by 1° start at 0.65


def check_inside(camera: str, px: ndarray, size: tuple[int, int], fit: HomographyFit, names: tuple[str, ...]) -> None:
    """Corners that fit their board, yet lie outside the image, show a wrong image size (outliers do not fit)."""
    width, height = size
    slack = np.maximum(_OUTSIDE_PX, 3 * np.nan_to_num(fit.sigma_px))[:, None]
    trusted = fit.weights > 0.5
    with np.errstate(invalid="ignore"):
        beyond = np.maximum(
            np.maximum(-0.5 - px[..., 0], px[..., 0] - (width - 0.5)),
            np.maximum(-0.5 - px[..., 1], px[..., 1] - (height - 0.5)),
        )
        outside = trusted & (beyond > slack)
    if not outside.any():
        return
    view, corner = np.unravel_index(int(np.argmax(np.where(outside, beyond, -np.inf))), outside.shape)
    x, y = px[view, corner]
    inside = px[trusted & (np.min(px, axis=-1, where=np.isfinite(px), initial=np.inf) > -0.5 - _OUTSIDE_PX)]
    hint = None
    if len(inside) == trusted.sum() and np.all(inside <= np.array([height, width]) + _OUTSIDE_PX):
        hint = f"the image size looks swapped: give {height}x{width}"
    found = finding(
        "corners-outside-image",
        remedy=hint,
        camera=camera,
        view=names[view],
        corner=int(corner),
        x_px=float(x),
        y_px=float(y),
        width_px=width,
        height_px=height,
        n_corners=int(outside.sum()),
        n_views=int(outside.any(axis=1).sum()),
    )
    raise refusal(found)


def _spacing_px(points: ndarray, fit: HomographyFit) -> Float[ndarray, "views"]:
    """Rough distance between neighbouring corners in each view, pixels."""
    xy = points[:, :2]
    sample = xy[:: max(1, len(xy) // 40)]
    distance2 = np.square(sample[:, None, 0] - xy[:, 0]) + np.square(sample[:, None, 1] - xy[:, 1])
    distance2[distance2 < 1e-24] = np.inf
    return float(np.median(np.sqrt(distance2.min(axis=1)))) * fit.px_per_unit


def check_grid(
    camera: str, points: ndarray, px: ndarray, fit: HomographyFit, names: tuple[str, ...], reasons: dict[int, Finding]
) -> None:
    """Views whose corners are no image of the board; refuses the set where nearly all are, and tries to say why."""
    n_seen = np.isfinite(px[..., 0]).sum(axis=1)
    with np.errstate(all="ignore"):
        off_grid = (fit.status == UNFIT) | (
            (fit.status == GOOD) & (fit.sigma_px > _OFF_GRID * _spacing_px(points, fit))
        )
    examined = np.isin(fit.status, (GOOD, UNFIT))
    if off_grid.sum() > MOST * max(examined.sum(), 1) and off_grid.sum() >= min(3, examined.sum()):
        order = transposed_order(points)
        if order is not None:
            other = fit_homographies(points[order], px)
            with np.errstate(all="ignore"):
                fits_now = (other.status == GOOD) & (other.sigma_px < 0.5 * _OFF_GRID * _spacing_px(points, fit))
            if fits_now.sum() > MOST * examined.sum():
                n_fitting, n_views = int(fits_now.sum()), int(examined.sum())
                raise refusal(
                    finding("columns-and-rows-exchanged", camera=camera, n_fitting=n_fitting, n_views=n_views)
                )
        view = int(np.flatnonzero(off_grid)[0])
        n_off, n_views = int(off_grid.sum()), int(examined.sum())
        raise refusal(finding("corners-off-grid", camera=camera, n_off=n_off, n_views=n_views, view=names[view]))
    for view in np.flatnonzero(n_seen > 0):
        i = int(view)
        if off_grid[i]:
            reasons.setdefault(i, finding("view-off-grid", camera=camera))
        elif fit.status[i] == COINCIDENT:
            x, y = np.nanmean(px[i], axis=0).tolist()
            reasons.setdefault(i, finding("view-at-one-point", camera=camera, x_px=x, y_px=y))
        elif fit.status[i] == COLLINEAR and n_seen[i] >= MIN_POINTS:
            reasons.setdefault(i, finding("view-on-a-line", camera=camera))


def check_degeneracy(camera: str, initial: InitialCamera, points: ndarray) -> None:
    """Sets of views from which no focal length follows; repeated poses count once."""
    usable = np.flatnonzero(initial.homographies.is_valid)
    H = initial.homographies.H[usable]
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    ends = np.array([[low[0], low[1], 1], [high[0], low[1], 1], [low[0], high[1], 1], [high[0], high[1], 1]])
    mapped = H @ ends.T
    with np.errstate(all="ignore"):
        ends_px = (mapped[:, :2] / mapped[:, 2:]).reshape(len(usable), -1)
    tolerance = max(1.0, 4 * float(np.median(initial.homographies.sigma_px[usable])) if initial.rms_px > 0 else 1.0)
    tolerance = min(tolerance, 5.0)
    fresh = np.ones(len(usable), dtype=bool)
    n_distinct = 0
    while fresh.any() and n_distinct < MIN_VIEWS:
        n_distinct += 1
        first = ends_px[np.argmax(fresh)]
        fresh &= np.sqrt(np.mean(np.square(ends_px - first), axis=1)) > tolerance
    if n_distinct < MIN_VIEWS:
        plural = "" if n_distinct == 1 else "s"
        raise refusal(finding("too-few-poses", camera=camera, n_poses=n_distinct, plural=plural, n_views=len(usable)))
    tilt_deg = _plain_tilts_deg(initial, points)
    try:
        check_orientations(initial.vanishing.K, initial.columns, initial.covariance, camera)
    except DegenerateGeometryError:
        if tilt_deg is None:
            raise
    else:
        if not initial.vanishing.sigma_log_focal > _MAX_SIGMA_LOG_FOCAL:
            return
    if tilt_deg is not None:
        raise refusal(finding("no-perspective", camera=camera, tilt_deg=tilt_deg))
    percent = 100 * float(initial.vanishing.sigma_log_focal)
    raise refusal(finding("tilts-too-small", camera=camera, sigma_percent=percent))


def _plain_tilts_deg(initial: InitialCamera, points: ndarray) -> float | None:
    """The boards' median tilt, where their shortening alone shows that they are tilted, and not all alike; else None.

    A far board's image is shortened by the cosine of its tilt, across an axis of its own, whatever the focal length is. None
    too where a lens may have shortened it: where it bends the board, or the boards are small beside the places where they are.
    """
    usable = initial.homographies.is_valid
    H, xy = initial.homographies.H[usable], points[:, :2]
    size = float(np.linalg.norm(np.ptp(xy, axis=0)))
    size_px = initial.homographies.px_per_unit[usable] * size
    h = H @ np.r_[xy.mean(axis=0), 1.0]
    px = h[:, :2] / h[:, 2:]
    places_px = np.linalg.norm(px - np.median(px, axis=0), axis=-1)
    is_bent = np.median(initial.homographies.sigma_px[usable] / size_px) > _UNBENT_SHARE
    if is_bent or np.median(size_px) < 2 * np.median(places_px):
        return None
    A = (H[:, :2, :2] - px[:, :, None] * H[:, 2:, :2]) / h[:, 2:, None]  # of the homography about the board's middle
    S = A @ A.swapaxes(1, 2)
    trace = S[:, 0, 0] + S[:, 1, 1]
    q = np.stack([S[:, 0, 0] - S[:, 1, 1], 2 * S[:, 0, 1]], axis=-1)
    length = np.linalg.norm(q, axis=-1)
    q = (
        2 * q / (trace + length)[:, None]
    )  # its length is the tilt's sine squared, its angle twice that of the shortening
    scatter = np.median(np.linalg.norm(q - np.median(q, axis=0), axis=-1))
    if not scatter > np.sin(_PLAIN_TILT_RAD) ** 2:
        return None
    return float(np.degrees(np.arcsin(np.sqrt(np.median(np.minimum(np.linalg.norm(q, axis=-1), 1.0))))))


def check_size(camera: str, initial: InitialCamera, px: ndarray) -> Finding | None:
    """A finding, or None, on too large an image size: principal point off the middle, no corner beyond twice that."""
    width, height = initial.size_wh
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    principal = initial.parameters[2:4]
    sigma = np.maximum(initial.vanishing.sigma_centre * initial.unit_px, 1.0)
    far = np.array([np.max(px[..., k], where=initial.weights > 0.5, initial=0.0) for k in range(2)])
    offset = centre - principal
    implied = 2 * principal + 1
    if not np.all(far < 1.12 * implied):  # lenses sit a few percent off the middle of their own image too
        return None
    figures = {
        "camera": camera,
        "x_px": float(principal[0]),
        "y_px": float(principal[1]),
        "width_px": width,
        "height_px": height,
        "far_x_px": float(far[0]),
        "far_y_px": float(far[1]),
        "implied_width_px": float(implied[0]),
        "implied_height_px": float(implied[1]),
    }
    if np.all(offset > 0.15 * np.array([width, height])) and np.all(offset > 6 * sigma):
        raise refusal(finding("image-size-wrong", **figures))
    if np.any((offset > 0.1 * np.array([width, height])) & (offset > 6 * sigma)):
        return finding("image-size-suspect", **figures)
    return None


def check_resolution(pixels: list[ndarray], sizes: list[tuple[int, int]], fits: list[HomographyFit]) -> None:
    """One camera's corners at a fraction of its image: they keep to its first part, and boards look smaller."""
    both = fits[0].is_valid & fits[1].is_valid
    if both.sum() < MIN_VIEWS:
        return
    far = [
        np.array([np.max(px[..., k], where=fit.weights > 0.5, initial=0.0) for k in range(2)]) / size
        for px, size, fit in zip(pixels, sizes, fits, strict=True)
    ]
    scale = [fit.px_per_unit[both] / size[0] for fit, size in zip(fits, sizes, strict=True)]
    ratio = float(np.median(scale[1] / scale[0]))
    for side, (name, other) in enumerate((("right", "left"), ("left", "right"))):
        k = 1 - side
        share = ratio if k == 1 else 1 / ratio
        if share < 0.62 and np.all(far[k] < share * 1.15) and np.any(far[1 - k] > 0.62):
            width, height = sizes[k]
            found = finding(
                "resolution-mismatch",
                camera=name,
                other=other,
                far_x_px=float(far[k][0] * width),
                far_y_px=float(far[k][1] * height),
                width_px=width,
                height_px=height,
                share=share,
            )
            raise refusal(found)
