"""One calibrated camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras.models import CameraModel, camera_model
from binocal.shapes import Bool, Float
from binocal.values import ArrayValue, frozen_array

MOST_SIDE_PX = 1 << 20  # line cameras have 16,384


@dataclass(frozen=True, slots=True, eq=False)
class Camera(ArrayValue):
    """A camera model with its numbers.

    ``parameters`` = fx, fy, cx, cy, skew (pixels), then the distortion in OpenCV's order.

    Axes x right, y down, z forward; pixel (0, 0) is the centre of the top-left pixel.
    """

    model: str
    size_wh: tuple[int, int]
    parameters: Float[ndarray, "p"]

    def __post_init__(self) -> None:
        parameters = frozen_array(self.parameters)
        expected = self._functions.n_parameters
        if parameters.shape != (expected,):
            raise ValueError(
                f"{self.model} has {expected} parameters (fx fy cx cy skew + distortion); got {parameters.shape}"
            )
        if not np.all(np.isfinite(parameters)) or parameters[0] <= 0 or parameters[1] <= 0:
            raise ValueError(f"camera parameters must be finite with fx, fy > 0; got {parameters.tolist()}")
        width, height = (int(n) for n in self.size_wh)
        if width < 1 or height < 1:
            raise ValueError(f"size_wh must be positive; got {self.size_wh}")
        if max(width, height) > MOST_SIDE_PX:
            raise ValueError(f"size_wh is at most {MOST_SIDE_PX} pixels a side; got {width:.4g} x {height:.4g}")
        object.__setattr__(self, "parameters", parameters)
        object.__setattr__(self, "size_wh", (width, height))

    @staticmethod
    def from_opencv(
        K: Float[ndarray, "3 3"], distortion: Float[ndarray, "d"], size_wh: tuple[int, int], *, is_fisheye: bool = False
    ) -> Camera:
        """Camera from OpenCV's matrices; 0 to 8 Brown-Conrady coefficients (missing ones are 0), or 4 fisheye ones."""
        K = np.asarray(K, dtype=float)
        d = np.asarray(distortion, dtype=float).ravel()
        while d.size > 8 and d[-1] == 0:
            d = d[:-1]
        if is_fisheye:
            model = "fisheye4"
        else:
            if d.size > 8:
                raise ValueError(f"thin-prism and tilted coefficients are not supported; got {d.size} coefficients")
            model = "brown4" if d.size <= 4 else "brown5" if d.size == 5 else "brown8"
        full = np.zeros(camera_model(model).n_parameters - 5)
        full[: d.size] = d
        return Camera(model, size_wh, np.r_[K[0, 0], K[1, 1], K[0, 2], K[1, 2], K[0, 1], full])

    @property
    def _functions(self) -> CameraModel:
        return camera_model(self.model)

    @property
    def K(self) -> Float[ndarray, "3 3"]:
        """Pinhole matrix, eq. 1: [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]."""
        fx, fy, cx, cy, skew = self.parameters[:5]
        return np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1]])

    @property
    def distortion(self) -> Float[ndarray, "d"]:
        """Distortion coefficients in OpenCV's order."""
        return self.parameters[5:].copy()

    def project(self, points: Float[ndarray, "*batch n 3"]) -> Float[ndarray, "*batch n 2"]:
        """Pixels of points in the camera frame (metres, or any unit).

        NaN where a point is behind a camera that cannot see there.
        """
        points = np.asarray(points, dtype=float)
        X, Y, Z = points[..., 0], points[..., 1], points[..., 2]
        with np.errstate(all="ignore"):
            u, v = self._functions.project(self.parameters, X, Y, Z)
        pixels = np.stack([u, v], axis=-1)
        if not self._functions.sees_behind:
            pixels[~(Z > 0)] = np.nan
        return pixels

    def unproject(self, pixels: Float[ndarray, "*batch 2"]) -> Float[ndarray, "*batch 3"]:
        """Unit rays of pixels in the camera frame; NaN where the model has none."""
        pixels = np.asarray(pixels, dtype=float)
        X, Y, Z, _ = self._functions.unproject(self.parameters, pixels[..., 0], pixels[..., 1])
        rays = np.stack([X, Y, Z], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    def sees(self, rays: Float[ndarray, "*batch n 3"]) -> Bool[ndarray, "*batch n"]:
        """Whether rays of the camera frame (directions, of any length) have a pixel in the image.

        A strong lens model folds back far outside its image: there, pixels in it belong to other rays, and such rays are not seen.
        """
        rays = np.asarray(rays, dtype=float)
        pixels = self.project(rays)
        with np.errstate(all="ignore"):
            is_inside = np.all((pixels >= -0.5) & (pixels <= np.array(self.size_wh) - 0.5), axis=-1)
            unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        farthest_angle = self._functions.farthest_angle
        if farthest_angle is not None:
            return is_inside & (unit[..., 2] > np.cos(farthest_angle(self.parameters)))
        back = self.unproject(np.where(is_inside[..., None], pixels, np.nan))
        return is_inside & (np.linalg.norm(np.where(np.isnan(back), np.inf, back) - unit, axis=-1) < 1e-6)
