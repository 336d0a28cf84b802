"""Corners in rendered images: errors of binocal and of OpenCV over what the images allow at best.

The bound of a corner is the inverse Fisher information of a nine-parameter saddle (position, two edge angles, blur,
offset, contrast, two additive slopes of the grey value) over the pixels of the disc that binocal's fit takes (0.85 of
the way to the next edge, 3 to 14 px), at the true corner, for the pixel noise that was rendered, rounding included.
Everyone starts from the truth within a pixel, so that only refinement is compared; findChessboardCornersSB finds its
own. Images differ by seed in pose, size and place of the board. A second table has lenses of 60 to 200 degrees, by ring of
the image (:mod:`.corner_rings`).
"""

from __future__ import annotations

import platform
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.benchmark.corner_bound import corner_bound
from binocal.benchmark.corner_rings import format_rings, measure_rings
from binocal.boards import parse_board
from binocal.cameras import Camera
from binocal.detection.measuring.corner_fit import fit_corners
from binocal.geometry import SE3
from binocal.geometry.so3 import exp
from binocal.kernels.corner_fits import BoardPlaces
from binocal.shapes import Float
from binocal.simulation import RenderOptions, render_image

BOARD = "chessboard:11x8:20mm"
SIZE_WH = (1280, 960)
BLURS_PX = (0.5, 0.8, 1.2, 2.0, 3.0)
NOISES_DN = (1.0, 3.0, 10.0)
MAX_START_PX = 1.0
OUTLIER_PX = 0.5  # an error beyond it is counted as a failure, else one corner taken for another decides the rms
_MIN_RADIUS_PX, _MAX_RADIUS_PX, _PER_REACH = 3.0, 14.0, 0.85


@dataclass(frozen=True, slots=True)
class _Case:
    """One row of the table: how the images are rendered, and whether they pass through JPEG."""

    name: str
    options: dict[str, Any]
    is_jpeg: bool = False


@dataclass(slots=True)
class _Tally:
    """Errors of one method in one case."""

    errors_px: list[ndarray] = field(default_factory=list)
    whitened: list[ndarray] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)
    ratio_by_image: list[float] = field(default_factory=list)
    n_failed: int = 0


def _cases(blurs_px: tuple[float, ...], noises_dn: tuple[float, ...]) -> list[_Case]:
    rows = [
        _Case(f"blur {blur:g}, noise {noise:g}", {"blur_px": blur, "noise_dn": noise})
        for blur in blurs_px
        for noise in noises_dn
    ]
    degraded = {"blur_px": 0.8, "noise_dn": 3.0}
    return rows + [
        _Case("disc blur 1.5", {**degraded, "blur_px": 1.5, "blur_kind": "disc"}),
        _Case("gamma 2.2", {**degraded, "gamma": 2.2}),
        _Case("JPEG 90", degraded, is_jpeg=True),
        _Case("vignetting 40 %", {**degraded, "vignetting": 0.4}),
        _Case("motion 2 px", {**degraded, "motion_px": (1.6, 1.2)}),
        _Case("16 bit", {**degraded, "bit_depth": 16}),
    ]


def _shoot(case: _Case, seed: int) -> tuple[ndarray, Float[ndarray, "n 2"], Float[ndarray, "n 2"]]:
    """An image, its true corners (NaN outside) and starts beside them."""
    import cv2

    rng = np.random.default_rng(seed)
    board, (width, height) = parse_board(BOARD), SIZE_WH
    camera = Camera("brown4", SIZE_WH, np.r_[1.1 * width, 1.1 * width, width / 2, height / 2, 0, -0.1, 0.02, 0, 0])
    points = board.object_points_m
    extent = float(np.ptp(points[:, :2], axis=0).max())
    tilt, way, roll = np.radians(rng.uniform(0, 60)), rng.uniform(0, 2 * np.pi), rng.uniform(-0.6, 0.6)
    R = exp(tilt * np.array([np.cos(way), np.sin(way), 0.0])) @ exp(np.array([0.0, 0.0, roll]))
    distance = extent * rng.uniform(1.4, 3.5)
    place = np.r_[rng.uniform(-0.12, 0.12, 2) * (distance - extent), distance]
    rendered = render_image(camera, SE3(R, place - R @ points.mean(axis=0)), board, RenderOptions(**case.options), rng)
    image = rendered.image
    if case.is_jpeg:
        content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        image = np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE))
    start = rendered.corners_px + rng.uniform(-MAX_START_PX, MAX_START_PX, rendered.corners_px.shape)
    return image, rendered.corners_px, start


def _edges(corners: Float[ndarray, "n 2"]) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n"]]:
    """Directions (radians) of the two edges through each true corner, and the distance to the next edge, px."""
    board = parse_board(BOARD)
    grid = corners.reshape(board.rows, board.columns, 2)
    along_x, along_y = (np.asarray(np.gradient(grid, axis=axis)) for axis in (1, 0))
    cross = np.abs(along_x[..., 0] * along_y[..., 1] - along_x[..., 1] * along_y[..., 0])
    reach = cross / np.maximum(np.linalg.norm(along_x, axis=-1), np.linalg.norm(along_y, axis=-1))
    angles = np.stack([np.arctan2(d[..., 1], d[..., 0]) for d in (along_x, along_y)], axis=-1)
    return angles.reshape(-1, 2), reach.ravel()


def _levels(case: _Case) -> tuple[float, float, float]:
    """Effective blur (px, pixel integration included), contrast and noise (grey levels of 8 bit) of a case's images."""
    options = case.options
    blur2 = options["blur_px"] ** 2 / 4 if options.get("blur_kind") == "disc" else options["blur_px"] ** 2
    motion = options.get("motion_px", (0.0, 0.0))
    blur2 += (
        1 / 12 + 0.5 * (motion[0] ** 2 + motion[1] ** 2) / 12
    )  # a uniform path, half of it across each of two edges
    gamma = options.get("gamma", 1.0)
    dark, bright = (255 * (level / 255) ** (1 / gamma) for level in (30.0, 210.0))
    rounding2 = 0.0 if options.get("bit_depth") == 16 else 1 / 12
    return float(np.sqrt(blur2)), bright - dark, float(np.sqrt(options["noise_dn"] ** 2 + rounding2))


def _run_case(case: _Case, seeds: range) -> dict[str, _Tally]:
    import cv2

    board = parse_board(BOARD)
    size = (board.columns, board.rows)
    tallies = {name: _Tally() for name in ("binocal", "cornerSubPix", "SB", "SB accurate")}
    blur_px, contrast_dn, noise_dn = _levels(case)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    for seed in seeds:
        image, truth, start = _shoot(case, seed)
        edges, reach = _edges(truth)
        usable = np.isfinite(truth).all(axis=1) & (reach > 0)
        margin = np.minimum(truth, np.array(SIZE_WH) - 1 - truth).min(axis=1)
        radius = np.clip(_PER_REACH * reach, _MIN_RADIUS_PX, _MAX_RADIUS_PX)
        usable &= margin > radius + 3
        bound = np.full((len(truth), 2, 2), np.nan)
        for i in np.nonzero(usable)[0]:
            bound[i] = corner_bound(
                truth[i], edges[i], blur_px=blur_px, contrast_dn=contrast_dn, noise_dn=noise_dn, radius_px=radius[i]
            )  # fmt: skip
        image8 = image if image.dtype == np.uint8 else np.rint(image / 257).astype(np.uint8)
        half = int(np.clip(np.floor(0.38 * np.median(reach[usable])), 2, 11))

        def fit(
            image: ndarray = image, start: ndarray = start, reach: ndarray = reach
        ) -> tuple[ndarray, ndarray | None]:
            fitted = fit_corners(image, start, reach, board=BoardPlaces(board.object_points_m[:, :2], board.pitch_m))
            return fitted.points_px, fitted.covariance_px2

        def sub_pix(
            image: ndarray = image8, start: ndarray = start, half: int = half
        ) -> tuple[ndarray, ndarray | None]:
            end = np.full(start.shape, np.nan)
            inside = (start > half + 1).all(axis=1) & (start < np.array(SIZE_WH) - half - 2).all(axis=1)
            rough = start[inside].astype(np.float32)[:, None].copy()
            end[inside] = cv2.cornerSubPix(image, rough, (half, half), (-1, -1), stop)[:, 0]
            return end, None

        def sector(flags: int, image: ndarray = image8, truth: ndarray = truth) -> tuple[ndarray, ndarray | None]:
            found, corners = cv2.findChessboardCornersSB(image, size, flags=flags)
            if not found:
                return np.full(truth.shape, np.nan), None
            corners = corners.reshape(-1, 2).astype(float)
            return min((corners, corners[::-1]), key=lambda c: float(np.nanmedian(np.abs(c - truth)))), None

        methods = {
            "binocal": fit,
            "cornerSubPix": sub_pix,
            "SB": lambda: sector(0),
            "SB accurate": lambda: sector(cv2.CALIB_CB_ACCURACY),
        }
        for name, method in methods.items():
            begin = time.perf_counter()
            points, covariance = method()
            tallies[name].times_s.append(time.perf_counter() - begin)
            _score(tallies[name], points - truth, covariance, bound, usable)
    return tallies


def _score(
    tally: _Tally, error: ndarray, covariance: ndarray | None, bound: Float[ndarray, "n 2 2"], usable: ndarray
) -> None:
    """Add an image's errors, relative to the bound's root mean square over the same corners."""
    good = usable & (np.nan_to_num(np.linalg.norm(error, axis=1), nan=np.inf) < OUTLIER_PX)
    tally.n_failed += int((usable & ~good).sum())
    if not good.any():
        return
    tally.errors_px.append(error[good])
    best2 = np.trace(bound[good], axis1=1, axis2=2)
    tally.ratio_by_image.append(float(np.sqrt(np.mean((error[good] ** 2).sum(axis=1) / best2))))
    if covariance is not None:
        root = np.linalg.cholesky(covariance[good])
        tally.whitened.append(np.linalg.solve(root, error[good][..., None])[..., 0].ravel())


def run_corners_benchmark(
    *,
    blurs_px: tuple[float, ...] = BLURS_PX,
    noises_dn: tuple[float, ...] = NOISES_DN,
    images: int = 6,
    images_a_lens: int = 120,
    seed: int = 0,
) -> dict[str, Any]:
    """Errors over the bound, bias, coverage of the stated covariance and time per image, for every case and method.

    And by ring of the image for lenses of 60 to 200 degrees.

    OpenCV's finder SB is timed with its search, the refinements without.
    """
    import cv2

    rows = []
    for case in _cases(blurs_px, noises_dn):
        row: dict[str, Any] = {"case": case.name}
        for name, tally in _run_case(case, range(seed, seed + images)).items():
            row[name] = _summary(tally)
        rows.append(row)
    rings = measure_rings(images_a_lens, seed)
    machine = (
        f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, OpenCV {cv2.__version__}"
    )
    return {
        "benchmark": "corners",
        "board": BOARD,
        "image_size": list(SIZE_WH),
        "images": images,
        "seed": seed,
        "machine": machine,
        "rows": rows,
        "rings": rings,
        "text": _format(rows, machine, images) + "\n\n" + format_rings(rings, images_a_lens),
    }


def _summary(tally: _Tally) -> dict[str, Any] | None:
    if not tally.errors_px:
        return {"n_failed": tally.n_failed, "median_ms": 1e3 * float(np.median(tally.times_s))}
    errors, ratios = np.concatenate(tally.errors_px), np.array(tally.ratio_by_image)
    summary: dict[str, Any] = {
        "over_bound": float(np.sqrt(np.mean(ratios**2))),
        "over_bound_range": [float(ratios.min()), float(ratios.max())],
        "rms_px": float(np.sqrt(np.mean(errors**2))),
        "bias_px": errors.mean(axis=0).tolist(),
        "bias_error_px": float(np.sqrt(np.mean(errors**2) / len(errors))),
        "n_corners": len(errors),
        "n_failed": tally.n_failed,
        "median_ms": 1e3 * float(np.median(tally.times_s)),
    }
    if tally.whitened:
        whitened = np.abs(np.concatenate(tally.whitened))
        summary |= {"within_1_sigma": float(np.mean(whitened < 1)), "within_2_sigma": float(np.mean(whitened < 2))}
    return summary


def _format(rows: list[dict[str, Any]], machine: str, images: int) -> str:
    def ratio(entry: dict[str, Any]) -> str:
        if "over_bound" not in entry:
            return "none found"
        low, high = entry["over_bound_range"]
        failed = f" -{entry['n_failed']}" if entry["n_failed"] else ""
        return f"{entry['over_bound']:.2f} ({low:.2f}..{high:.2f}){failed}"

    names = ("binocal", "cornerSubPix", "SB", "SB accurate")
    lines = [
        f"corner error over the image-level bound, {BOARD}, {SIZE_WH[0]}x{SIZE_WH[1]}, {images} images a row ({machine})",
        "rms (worst and best image) -corners failed; bias: mean error and its standard error, px; 1 and 2 sigma: share within what is stated",
        "",
        f"{'case':<20}" + "".join(f"{name:>28}" for name in names) + f"{'bias':>27}{'1, 2 sigma':>14}{'ms':>22}",
    ]
    for row in rows:
        ours = row["binocal"]
        bias = "{:+.4f} {:+.4f} ± {:.4f}".format(*ours.get("bias_px", (np.nan,) * 2), ours.get("bias_error_px", np.nan))
        inside = f"{ours.get('within_1_sigma', np.nan):.2f} {ours.get('within_2_sigma', np.nan):.2f}"
        times = "/".join(f"{row[name]['median_ms']:.1f}" for name in names)
        lines.append(
            f"{row['case']:<20}"
            + "".join(f"{ratio(row[name]):>28}" for name in names)
            + f"{bias:>27}{inside:>14}{times:>22}"
        )
    return "\n".join(lines)
