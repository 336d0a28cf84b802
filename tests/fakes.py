"""Stand-ins for the heavy packages, so that the shells are tested alone: exact corners instead of images."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import binocal.calibrators.agreement  # bound to the real solvers
import binocal.metrics.held_out  # bound to the real simulation
import binocal.validation  # noqa: F401 - bound to the real calibrators
from binocal.calibrators import load_calibrator
from binocal.findings import finding
from binocal.result import Covariance, Evidence, RejectedView, ResidualSummary, StereoCalibration, ViewResult
from binocal.simulation import Setup, StereoScene
from rigs import make_detections, make_poses, make_rig


@dataclass(frozen=True)
class Pair:
    name: str
    left_path: Path
    right_path: Path


@dataclass(frozen=True)
class Pairing:
    pairs: tuple[Pair, ...]
    ignored: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class PairDetections:
    detections: Any
    rejected: tuple[RejectedView, ...]
    notes: tuple[str, ...]
    input_sha256: dict[str, str]


@dataclass(frozen=True)
class RenderOptions:
    blur_px: float
    noise_dn: float


class FakePackages:
    """The fake packages; a test changes a function to make its own case."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.rig, self.poses = make_rig(), make_poses(6, np.random.default_rng(0))
        self.detections = make_detections(self.rig, self.poses)
        self.rejected = (RejectedView("07", "no board found in the right image"),)
        self.calibrate: Callable[..., StereoCalibration] = self._calibrate
        self.calls: dict[str, Any] = {}
        packages = {
            "binocal.calibrators": {
                "calibrate_as_requested": self._call_calibrate,
                "CALIBRATORS": {"drl": lambda: self.calibrate},
                "load_calibrator": load_calibrator,
            },
            "binocal.datasets": {},
            "binocal.datasets.folder": {"list_pairs": self._list_pairs},
            "binocal.detection": {"detect_pairs": self._detect_pairs},
            "binocal.simulation": {
                "table2_rig": lambda: self.rig,
                "sample_board_poses": lambda rig, board, n_views, rng: make_poses(n_views, rng),
                "RenderOptions": RenderOptions,
                "Setup": Setup,
                "SETUPS": {"table2": lambda: Setup(self.rig)},
                "StereoScene": StereoScene,
                "render_pairs": self._render_pairs,
            },
            "binocal.solvers.covariance": {"cramer_rao_bound": self._bound},
            "binocal.benchmark": {"run": self._bench},
        }
        for name, content in packages.items():
            module = ModuleType(name)
            vars(module).update(content)
            monkeypatch.setitem(sys.modules, name, module)

    def _list_pairs(self, left: str, right: str) -> Pairing:
        self.calls["list_pairs"] = (left, right)
        pairs = tuple(Pair(name, Path(f"left{name}.png"), Path(f"right{name}.png")) for name in self.detections.names)
        return Pairing(pairs, (("left99 copy.png", "a copy of left99.png"),))

    def _detect_pairs(
        self,
        pairs,
        board,
        *,
        progress=None,
        should_stop=None,
        n_threads=None,
        preparation=None,
        least_pairs=0,
        expect=None,
    ):
        self.calls["preprocess"] = preparation is not None and preparation.strengthens
        if progress:
            progress(len(pairs), len(pairs))
        return PairDetections(
            self.detections,
            self.rejected,
            ("left and right images differ in size",),
            {"left": "0" * 64, "right": "1" * 64},
        )

    def _call_calibrate(self, detections, request, *, calibrator, inputs):
        self.calls["calibrate"] = request
        self.calls["calibrator"] = calibrator
        calibration = self.calibrate(detections, request)
        return replace(calibration, provenance={**calibration.provenance, "seed": request.seed, **inputs})

    def _calibrate(self, detections, request) -> StereoCalibration:
        names = tuple(f"{side}.{name}" for side in ("left", "right") for name in ("fx", "fy", "cx", "cy", "k1"))
        names += tuple(f"{block}.{axis}" for block in ("rotation", "translation") for axis in "xyz")
        sigma = np.r_[np.full(10, 0.05), np.full(3, 1e-5), np.full(3, 2e-6)]
        views = tuple(ViewResult(name, 0.1, 0.1, 0.1, 176) for name in detections.names)
        return StereoCalibration(
            rig=self.rig,
            covariance=Covariance(names, np.diag(sigma**2)),
            rms=ResidualSummary(0.11, 0.12, 0.115),
            noise_px=0.08,
            views=views,
            evidence=Evidence(detections, self.poses),
            findings=(finding("cameras-exchanged"),),
            provenance={"iterations": 5},
        )

    def _bound(
        self,
        rig,
        object_points_m,
        T_left_board,
        noise_px,
        *,
        left_is_seen=None,
        right_is_seen=None,
        skew=False,
        weights=None,
    ):
        self.calls["bound"] = {"n_views": len(T_left_board.t), "noise_px": noise_px, "n_seen": int(left_is_seen.sum())}
        return self._calibrate(self.detections, None).covariance

    def _render_pairs(self, scene, options, seed, progress=None, aberration_px=None):
        n_views = len(scene.T_left_board.t)
        for view in range(n_views):
            for side, camera in (("left", scene.rig.left), ("right", scene.rig.right)):
                rng = np.random.default_rng(seed.spawn(1)[0])
                yield view, side, rng.integers(0, 255, camera.size_wh[::-1], dtype=np.uint8)
            if progress:
                progress(view + 1, n_views)

    def _bench(self, name, *, seed=0):
        if name != "solver":
            raise ValueError(f"unknown benchmark {name!r}; known: solver")
        return {"benchmark": name, "seed": seed, "rows": [{"pairs": 20}], "text": "20 pairs: 18.8 times"}
