"""What every calibrator, every file format and every camera model must do, built in or added by a package."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import binocal
from binocal.boards import parse_board
from binocal.calibrators.registry import evidence_of
from binocal.cameras import Camera, StereoRig, camera_model
from binocal.errors import BinocalError, CancelledError, DataError, FormatError, OutputExistsError, TooFewViewsError
from binocal.evidence import Detections
from binocal.evidence.zoom_settings import ZoomSettings
from binocal.formats.registry import load_format
from binocal.geometry import SE3, so3
from binocal.result import Covariance, StereoCalibration
from binocal.simulation import StereoScene, random_rig, sample_board_poses, simulate_detections, table2_rig
from binocal.simulation.turning import simulate_turning, turning_rig
from binocal.simulation.zoom import zoom_rig_at
from binocal.solvers.prior import RigPrior
from rigs import assert_same_rig

BOARD = parse_board("chessboard:11x8:20mm")


MODELS = {"wide-field": "fisheye4"}  # of calibrators that solve for one camera model alone
FROM_LM = {"opencv": 4.0, "absolute-orientation": 4.0, "heterogeneous": 0.1}
"""Of their own standard deviations, of those that do not end where lm does."""


def make_corners(n_views: int = 8, seed: int = 0, noise_px: float = 0.2, model: str = "brown4") -> Detections:
    rng = np.random.default_rng(seed)
    rig = table2_rig() if model == "brown4" else random_rig(rng, model, size_wh=(640, 512), field_deg=180)
    return simulate_detections(
        StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng)), rng, noise_px=noise_px
    )


# Calibrators


def solve(name: str, evidence: Detections, **choices) -> StereoCalibration:
    return binocal.calibrate(
        evidence, calibrator=name, **choices_for(name) | {"model": MODELS.get(name, "brown4"), **choices}
    )


def evidence_for(name: str) -> Any:
    """Evidence that suits a calibrator."""
    if evidence_of(name) == "rectangles":
        return simulate_turning(turning_rig(), 4, np.random.default_rng(0)).pairs
    if evidence_of(name) == "zoom":
        return make_zoom_corners()
    return corners_for(name)


def make_zoom_corners(n_settings: int = 5, n_views: int = 3) -> ZoomSettings:
    rng, made = np.random.default_rng(0), []
    settings = np.linspace(10.0, 50.0, n_settings)
    for share in np.linspace(0, 1, n_settings):
        rig = zoom_rig_at(share)
        scene = StereoScene(rig, BOARD, sample_board_poses(rig, BOARD, n_views, rng))
        made.append(simulate_detections(scene, rng, noise_px=0.02))
    return ZoomSettings(settings, tuple(made))


def choices_for(name: str) -> dict[str, Any]:
    """What a calibrator needs beside its evidence."""
    if evidence_of(name) != "rectangles":
        return {}
    names = ("left.fx", "right.cy", "rotation.x", "rotation.y", "rotation.z", "translation.x")
    covariance = Covariance(names, np.diag([0.3, 0.4, 1e-4, 1e-4, 1e-4, 2e-4]) ** 2)
    return {"prior": RigPrior.from_rig(turning_rig(), covariance)}


def corners_for(name: str, n_views: int = 8, seed: int = 0) -> Detections:
    return make_corners(n_views, seed, model=MODELS.get(name, "brown4"))


def same_seed_same_result(name: str) -> None:
    one, other = (solve(name, evidence_for(name), seed=3) for _ in range(2))
    assert_same_rig(one.rig, other.rig)
    assert np.array_equal(one.covariance.matrix, other.covariance.matrix)
    assert one.views == other.views and one.provenance == other.provenance


def arrays_of(value: Any) -> list[np.ndarray]:
    """All arrays in a piece of evidence, those of its parts too."""
    found = []
    for item in (getattr(value, field.name) for field in fields(value)):
        if isinstance(item, np.ndarray):
            found.append(item)
        elif isinstance(item, tuple) and item and isinstance(item[0], Detections):
            found += [array for part in item for array in arrays_of(part)]
    return found


def input_stays_as_it_was(name: str) -> None:
    evidence, options = evidence_for(name), {}
    arrays = arrays_of(evidence)
    before = [array.tobytes() for array in arrays]
    solve(name, evidence, options=options)
    assert len(arrays) >= 3 and before == [array.tobytes() for array in arrays]
    assert not any(array.flags.writeable for array in arrays) and options == {}


def too_few_views_are_refused(name: str) -> None:
    with pytest.raises(TooFewViewsError) as caught:
        solve(name, corners_for(name).select(np.arange(2)))
    assert (caught.value.found, caught.value.needed) == (2, 3)


def result_comes_back_from_its_file(name: str, folder: Path) -> None:
    made, evidence = solve(name, evidence_for(name)), evidence_for(name)
    binocal.write_calibration(folder / "rig.json", made)
    read = binocal.read_calibration(folder / "rig.json")
    assert_same_rig(read.rig, made.rig)
    assert read.views == made.views and read.rejected == made.rejected and read.provenance["calibrator"] == name
    if evidence_of(name) != "board":
        return
    whole = read.with_evidence(evidence)
    assert np.array_equal(whole.evidence.T_left_board.t, made.evidence.T_left_board.t)


def progress_and_stop_are_honoured(name: str) -> None:
    seen: list[tuple[str, int, int]] = []
    evidence = evidence_for(name)
    solve(name, evidence, progress=lambda *step: seen.append(step))
    assert seen and seen[-1][1] == seen[-1][2]
    asked: list[int] = []
    solve(name, evidence, should_stop=lambda: asked.append(1) is not None)
    assert len(asked) > 2  # around the method and within it
    for last in sorted({round(i) for i in np.linspace(0, len(asked) - 1, 6)}):
        answers = iter([False] * last + [True])
        with pytest.raises(CancelledError):
            solve(name, evidence, should_stop=lambda answers=answers: next(answers))


def agrees_with_lm(name: str) -> None:
    evidence, model = corners_for(name, 10, seed=1), MODELS.get(name, "brown4")
    lm, other = solve("lm", evidence, model=model), solve(name, evidence)
    sigma, limit = other.covariance.sigma, FROM_LM.get(name, 0.01)
    for side in ("left", "right"):
        a, b = getattr(lm.rig, side), getattr(other.rig, side)
        for parameter, x, y in zip(camera_model(a.model).parameter_names, a.parameters, b.parameters, strict=True):
            if f"{side}.{parameter}" in sigma:
                assert abs(x - y) < limit * sigma[f"{side}.{parameter}"], parameter
    turn = so3.log(other.rig.T_right_left.R @ lm.rig.T_right_left.R.T)
    shift_m = other.rig.T_right_left.t - lm.rig.T_right_left.t
    for i, axis in enumerate("xyz"):
        assert abs(turn[i]) < limit * sigma[f"rotation.{axis}"]
        assert abs(shift_m[i]) < limit * sigma[f"translation.{axis}"]


def unknown_option_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="no option 'turbo'"):
        solve(name, evidence_for(name), options={"turbo": 1})


def other_evidence_is_refused(name: str) -> None:
    with pytest.raises((TypeError, AttributeError)):
        solve(name, np.zeros((3, 4)))


BOARD_CONTRACT: tuple[Callable[[str], None], ...] = (too_few_views_are_refused, agrees_with_lm)
"""What those must do beside that work from a board's corners."""
CALIBRATOR_CONTRACT: tuple[Callable[[str], None], ...] = (
    same_seed_same_result,
    input_stays_as_it_was,
    progress_and_stop_are_honoured,
    unknown_option_is_refused,
    other_evidence_is_refused,
)


# Formats


def make_rigs() -> list[StereoRig]:
    """Ordinary, fisheye, skewed, without a scale, with two image sizes, of an odd number."""
    rng = np.random.default_rng(0)
    made = []
    for model in ("brown4", "brown5", "brown8", "fisheye4"):
        n = len(camera_model(model).distortion_names)
        for skew, is_metric, size_wh in ((0.0, True, (640, 480)), (0.25, True, (640, 480)), (0.0, False, (1280, 720))):
            cameras = [
                Camera(
                    model, size, np.r_[rng.uniform(500, 600, 2), 320.1, 240 / 7, skew, 1e-3 * rng.standard_normal(n)]
                )
                for size in ((640, 480), size_wh)
            ]
            T_right_left = SE3(so3.exp(0.05 * rng.standard_normal(3)), np.array([-0.1, 1e-3, 1 / 3000]))
            made.append(StereoRig(*cameras, T_right_left, is_metric))
    return made


def without(rig: StereoRig, losses: tuple[str, ...]) -> StereoRig:
    """The rig less what a format says that it loses."""
    if "unit" in losses:
        rig = replace(rig, is_metric=True)
    if "skew" in losses:
        sides = {
            side: replace(camera, parameters=np.where(np.arange(len(camera.parameters)) == 4, 0, camera.parameters))
            for side, camera in (("left", rig.left), ("right", rig.right))
        }
        rig = replace(rig, **sides)
    return rig


@pytest.mark.filterwarnings("ignore::UserWarning")
def what_is_written_comes_back_but_for_the_losses(name: str, folder: Path) -> None:
    file_format, n_whole = load_format(name), 0
    assert file_format.write is not None
    for number, rig in enumerate(make_rigs()):
        path, losses = folder / f"{number}{file_format.suffixes[0]}", file_format.losses(rig)
        try:
            file_format.write(path, rig)
        except DataError as error:
            assert losses and any(loss in str(error) for loss in losses)
            assert not path.exists()
            continue
        assert file_format.probe(path)
        assert_same_rig(file_format.read(path), without(rig, losses), 1e-12)
        if losses:  # what is named as lost is lost indeed
            with pytest.raises(AssertionError):
                assert_same_rig(file_format.read(path), rig, 1e-12)
        n_whole += not losses
        with pytest.raises(OutputExistsError):
            file_format.write(path, rig)
        file_format.write(path, rig, force=True)
    assert n_whole >= 4


def foreign_content_is_not_taken_for_its_own(name: str, folder: Path, others: tuple[str, ...]) -> None:
    file_format = load_format(name)
    foreign: list[Path] = [folder / "missing", folder]
    for number, content in enumerate((b"", b"{}", b"{", b"\xff\xfe\x00", b"<x/>", b"a: 1\n", b"[" * 5000, b"a = 1\n")):
        foreign.append(folder / f"foreign{number}{file_format.suffixes[0]}")
        foreign[-1].write_bytes(content)
    for other in others:
        writer = load_format(other)
        written = folder / f"of-{other}{writer.suffixes[0]}"
        writer.write(written, make_rigs()[0])
        foreign.append(written)
    for path in foreign:
        assert not file_format.probe(path), path.name
        with pytest.raises(FormatError) as caught:
            file_format.read(path)
        assert "\n" not in str(caught.value)


# Camera models


def make_camera(name: str, skew: float = 3.0) -> Camera:
    distortion = {"k1": -0.1, "k2": 0.03, "k3": 0.01, "k4": 0.02, "p1": 1e-3, "p2": -2e-3}
    if name == "fisheye4":
        distortion = {"k1": 0.01, "k2": -0.02, "k3": 0.003, "k4": -0.001}
    values = [distortion.get(key, 0.01) for key in camera_model(name).distortion_names]
    return Camera(name, (1280, 960), np.r_[800, 820, 640, 480, skew, values])


def sample_points(n: int = 60, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(-0.4, 0.4, n), rng.uniform(-0.4, 0.4, n), rng.uniform(0.8, 1.2, n)], axis=-1)


def record_is_whole(name: str) -> None:
    model = camera_model(name)
    assert model.name == name and model.n_parameters == 5 + len(model.distortion_names)
    assert len(model.prior_precision) == model.n_parameters == len(set(model.parameter_names))
    assert model.is_compiled == (name in binocal.cameras.CAMERA_MODELS)


def unprojecting_inverts_projecting(name: str) -> None:
    camera, points = make_camera(name), sample_points()
    rays = camera.unproject(camera.project(points))
    assert np.abs(rays - points / np.linalg.norm(points, axis=1, keepdims=True)).max() < 1e-12


def jacobians_are_the_derivatives(name: str) -> None:
    # step 1e-6 of the value: truncation ~1e-12, rounding ~1e-9 px / 1e-6; measured 5e-8 relative, bound 1e-6
    model, points = camera_model(name), sample_points()
    for skew in (0.0, 3.0):
        p = make_camera(name, skew).parameters
        J = np.empty((len(p), 2, len(points)))
        u, v, *gradients = model.linearize(p, *points.T, J)
        assert np.allclose(np.stack(model.project(p, *points.T)), np.stack([u, v]), atol=1e-10)
        for i in range(len(p)):
            step = 1e-6 * max(1, abs(p[i])) * np.eye(len(p))[i]
            ahead, behind = (np.stack(model.project(p + s, *points.T)) for s in (step, -step))
            numeric = (ahead - behind) / (2 * step[i])
            assert np.abs(numeric - J[i]).max() < 1e-6 * (1 + np.abs(numeric).max()), model.parameter_names[i]
        for axis in range(3):
            step = 1e-6 * np.eye(3)[axis]
            ahead, behind = (np.stack(model.project(p, *(points + s).T)) for s in (step, -step))
            numeric = (ahead - behind) / 2e-6
            analytic = np.stack([gradient[axis] for gradient in gradients])
            assert np.abs(numeric - analytic).max() < 1e-6 * (1 + np.abs(numeric).max()), "XYZ"[axis]


def leading_dimensions_broadcast(name: str) -> None:
    model, points = camera_model(name), sample_points()
    one, two = make_camera(name, 0.0).parameters, make_camera(name, 3.0).parameters
    together = model.project(np.stack([one, two]), *(np.stack([points, 2 * points]).transpose(2, 0, 1)))
    for i, p in enumerate((one, two)):
        assert np.allclose(together[0][i], model.project(p, *points.T)[0], atol=1e-9)


def impossible_numbers_are_refused(name: str) -> None:
    n = camera_model(name).n_parameters
    for parameters in (np.zeros(n), np.ones(n + 1), np.full(n, np.nan)):
        with pytest.raises((ValueError, BinocalError)):
            Camera(name, (640, 480), parameters)


CAMERA_CONTRACT: tuple[Callable[[str], None], ...] = (
    record_is_whole,
    unprojecting_inverts_projecting,
    jacobians_are_the_derivatives,
    leading_dimensions_broadcast,
    impossible_numbers_are_refused,
)
