"""A rig as a function of the zoom setting of its lenses: smooth curves, and a small network for what they leave.

Curves are of quantities that vary slowly with the zoom: logarithms of the focal lengths, principal points, distortion as the shift of
the image's corner relative to its radius, the rotation vector from a rig in the middle, the translation. Each is a polynomial of the
setting plus what a network with one hidden layer of tanh adds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from binocal.cameras.camera import Camera
from binocal.cameras.models import camera_model
from binocal.cameras.rig import StereoRig
from binocal.geometry import SE3, so3
from binocal.shapes import Float
from binocal.values import ArrayValue, frozen_array

SIDES = ("left", "right")
RADIAL = {
    "k1": 2,
    "k2": 4,
    "k3": 6,
    "k4": 2,
    "k5": 4,
    "k6": 6,
    "p1": 1,
    "p2": 1,
}  # powers of the radius, of Brown's models
NETWORK = ("into", "bias", "out")


@dataclass(frozen=True, slots=True, eq=False)
class Network(ArrayValue):
    """``polynomial`` (degree + 1, q) of the setting in [-1, 1], plus ``out`` (h, q) of tanh(``into`` x + ``bias``)."""

    polynomial: Float[ndarray, "d q"]
    into: Float[ndarray, "h"]
    bias: Float[ndarray, "h"]
    out: Float[ndarray, "h q"]

    def __post_init__(self) -> None:
        for name in ("polynomial", *NETWORK):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    def __call__(self, x: float) -> Float[ndarray, "q"]:
        """The curves at a setting in [-1, 1], in standard units."""
        return x ** np.arange(len(self.polynomial)) @ self.polynomial + np.tanh(self.into * x + self.bias) @ self.out


@dataclass(frozen=True, slots=True, eq=False)
class ZoomRig:
    """Cameras and their pose between two settings. ``middle`` is the rig whose sizes, model and rotation the curves refer to.

    ``networks`` are averaged; their outputs times ``scale`` plus ``centre`` are the curves' quantities
    (:func:`curve_quantities`).
    """

    low: float
    high: float
    middle: StereoRig
    centre: Float[ndarray, "q"]
    scale: Float[ndarray, "q"]
    networks: tuple[Network, ...]

    def quantities_at(self, setting: float) -> Float[ndarray, "q"]:
        """What the curves say at a setting.

        Raises:
            ValueError: The setting is outside of those that were calibrated.
        """
        if not self.low <= setting <= self.high:
            raise ValueError(f"zoom setting {setting:g} is outside of those calibrated, {self.low:g} to {self.high:g}")
        x = 2 * (setting - self.low) / (self.high - self.low) - 1
        return self.centre + self.scale * np.mean([network(x) for network in self.networks], axis=0)

    def rig_at(self, setting: float) -> StereoRig:
        """The rig at a setting. Raises as :meth:`quantities_at`."""
        return rig_of_quantities(self.quantities_at(setting), self.middle)

    def document(self) -> dict[str, Any]:
        """Plain data that :meth:`from_document` takes."""
        return {
            "low": self.low,
            "high": self.high,
            "model": self.middle.left.model,
            "sizes_wh": [list(camera.size_wh) for camera in (self.middle.left, self.middle.right)],
            "is_metric": self.middle.is_metric,
            "quantities": curve_quantities(self.middle, self.middle).tolist(),
            "R": self.middle.T_right_left.R.tolist(),
            "centre": self.centre.tolist(),
            "scale": self.scale.tolist(),
            "networks": [
                {name: getattr(network, name).tolist() for name in ("polynomial", *NETWORK)}
                for network in self.networks
            ],
        }

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> ZoomRig:
        """The zoom rig of what :meth:`document` gave, as in ``calibration.extra["zoom"]``.

        Raises:
            KeyError, ValueError: It is none.
        """
        model = camera_model(document["model"])
        cameras = [
            Camera(model.name, (int(w), int(h)), np.r_[1.0, 1.0, np.zeros(model.n_parameters - 2)])
            for w, h in document["sizes_wh"]
        ]
        blank = StereoRig(
            cameras[0], cameras[1], SE3(np.array(document["R"]), np.zeros(3)), bool(document["is_metric"])
        )
        networks = tuple(
            Network(*(np.array(one[name], dtype=float) for name in ("polynomial", *NETWORK)))
            for one in document["networks"]
        )
        return ZoomRig(
            float(document["low"]),
            float(document["high"]),
            rig_of_quantities(np.array(document["quantities"]), blank),
            np.array(document["centre"]),
            np.array(document["scale"]),
            networks,
        )


def curve_names(rig: StereoRig) -> tuple[str, ...]:
    """Names of the parameters behind the curves' quantities, as a covariance has them; no skew."""
    names = [
        f"{side}.{name}"
        for side in SIDES
        for name in camera_model(getattr(rig, side).model).parameter_names
        if name != "skew"
    ]
    return (*names, *(f"{part}.{axis}" for part in ("rotation", "translation") for axis in "xyz"))


def curve_quantities(rig: StereoRig, middle: StereoRig) -> Float[ndarray, "q"]:
    """The quantities that vary slowly with the zoom, in the order of :func:`curve_names`."""
    parts = []
    for side in SIDES:
        camera = getattr(rig, side)
        values = np.delete(camera.parameters, 4)
        values[4:] *= _corner_powers(camera, values[:2])
        values[:2] = np.log(values[:2])
        parts.append(values)
    turn = so3.log(rig.T_right_left.R @ middle.T_right_left.R.T)
    return np.concatenate([*parts, turn, rig.T_right_left.t])


def rig_of_quantities(quantities: Float[ndarray, "q"], middle: StereoRig) -> StereoRig:
    """The rig of :func:`curve_quantities`; skew 0."""
    cameras, first = [], 0
    for side in SIDES:
        camera = getattr(middle, side)
        n = len(camera.parameters) - 1
        values = quantities[first : first + n].copy()
        first += n
        values[:2] = np.exp(values[:2])
        values[4:] /= _corner_powers(camera, values[:2])
        cameras.append(Camera(camera.model, camera.size_wh, np.insert(values, 4, 0.0)))
    R = so3.project_to_rotation(so3.exp(quantities[first : first + 3]) @ middle.T_right_left.R)
    return StereoRig(cameras[0], cameras[1], SE3(R, quantities[first + 3 :]), middle.is_metric)


def by_parameters(rig: StereoRig, middle: StereoRig) -> Float[ndarray, "q q"]:
    """Derivative of the quantities by the parameters of a covariance, the rig stepped from the left."""
    n = len(curve_names(rig))
    J = np.eye(n)
    first = 0
    for side in SIDES:
        camera = getattr(rig, side)
        values = np.delete(camera.parameters, 4)
        powers = _corner_powers(camera, values[:2])
        size = len(values)
        for i in range(2):
            J[first + i, first + i] = 1 / values[i]
        J[range(first + 4, first + size), range(first + 4, first + size)] = powers
        for i, power in enumerate(_powers(camera)):  # the mean focal length is in the powers
            J[first + 4 + i, first : first + 2] = -power * values[4 + i] * powers[i] / values[:2].sum()
        first += size
    J[first : first + 3, first : first + 3] = so3.inverse_left_jacobian(
        so3.log(rig.T_right_left.R @ middle.T_right_left.R.T)
    )
    return J


def _powers(camera: Camera) -> list[int]:
    model = camera_model(camera.model)
    return [0 if model.sees_behind else RADIAL[name] for name in model.distortion_names]


def _corner_powers(camera: Camera, focal_px: Float[ndarray, "2"]) -> Float[ndarray, "d"]:
    """What each coefficient is multiplied by for the shift of the image's corner relative to its radius."""
    radius = np.hypot(*camera.size_wh) / 2 / focal_px.mean()
    return radius ** np.array(_powers(camera), dtype=float)
