"""From images without a board to a rig, a verdict and an exit code; real data sets where they are at hand."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from binocal.app import SimulateOptions, evaluate_truth, natural, simulate_scene
from binocal.cameras import Camera, StereoRig
from binocal.cli import main
from binocal.datasets import StereoPair
from binocal.errors import DataError
from binocal.formats import rig_json
from binocal.geometry import SE3, so3
from binocal.rl.agent_kind import AgentKind
from binocal.rl.policy import save_policy, shipped_policy

SIZE = (480, 360)
T = SE3(so3.exp(np.radians([0.4, -0.7, 0.3])), np.array([-0.25, 0.002, -0.004]))


def camera(shift=0.0):
    return Camera("brown4", SIZE, np.array([330.0, 331, 240 + shift, 179, 0, -0.18, 0.04, 5e-4, -4e-4]))


RIG = StereoRig(camera(), camera(2.0), T)


def turned(deg, axis=0):
    return StereoRig(RIG.left, RIG.right, SE3(so3.exp(np.radians(deg) * np.eye(3)[axis]) @ T.R, T.t))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("street") / "images"
    simulate_scene(RIG, "street", 2, path, SimulateOptions(0.7, 1.5, seed=4))
    rig_json.write_rig(path / "true.json", RIG)
    rig_json.write_rig(path / "turned.json", turned(1.0))
    return path


def run(*arguments):
    try:
        return main([str(a) for a in arguments])
    except SystemExit as error:
        return error.code


def sources(folder):
    return ["--left", folder / "left_*.png", "--right", folder / "right_*.png"]


def test_a_turned_rig_comes_back(folder, tmp_path, capsys):
    output = tmp_path / "new.json"
    assert run("recalibrate", *sources(folder), "--rig", folder / "turned.json", "--output", output, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    new = rig_json.read_calibration(output)
    assert np.degrees(so3.angle_rad(new.rig.T_right_left.R @ T.R.T)) < 0.05
    assert new.rig.baseline_m == pytest.approx(RIG.baseline_m)
    assert document["drift"]["pitch_deg"] == pytest.approx(1.0, abs=0.05) and document["drift"]["has_drifted"]
    assert document["rows"]["best"]["median_px"] < 0.15 < document["rows"]["given"]["median_px"]
    assert document["provenance"]["length_from"] == "the old rig"


def test_the_result_says_who_led(folder, tmp_path, capsys):
    output = tmp_path / "new.json"
    arguments = (*sources(folder), "--rig", folder / "turned.json", "--output", output, "--force")
    rotations = []
    for name, led_by in (("drl", "agent"), ("portfolio", "schedule 64 to 1"), ("lm", "schedule 64 to 1")):
        assert run("recalibrate", *arguments, "--calibrator", name) == 0
        assert f"Led by   {led_by}; " in capsys.readouterr().out
        new = rig_json.read_calibration(output)
        assert new.provenance["agent"]["won"] == led_by
        rotations.append(new.rig.T_right_left.R)
    np.testing.assert_allclose(rotations[1:], rotations[:1] * 2, atol=1e-5)


def test_unknown_calibrators_and_weights_of_boards_are_named(folder, tmp_path, capsys):
    arguments = (*sources(folder), "--rig", folder / "turned.json", "--output", tmp_path / "new.json")
    assert run("recalibrate", *arguments, "--calibrator", "best") == 2
    assert "known: drl, portfolio, lm" in " ".join(capsys.readouterr().err.split())
    boards = tmp_path / "boards.safetensors"
    save_policy(shipped_policy(AgentKind.DRL), boards)
    assert run("recalibrate", *arguments, "--calibrator", boards) == 3
    assert "which sees boards" in capsys.readouterr().err
    assert not (tmp_path / "new.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["street", "room"])
def test_rendered_scenes_give_the_true_rig_within_the_stated_deviations(kind, tmp_path):
    """Five scenes of a pair, the given rig turned by a degree: nothing drawn twice, things moving 20 ms apart."""
    scores = []
    for seed in range(5):
        folder = tmp_path / str(seed)
        simulate_scene(RIG, kind, 1, folder, SimulateOptions(0.7, 1.5, seed, gap_s=0.02))
        given = natural.load_given_rig(folder / "truth.json")
        source = natural.source_of_images(str(folder / "left_*.png"), str(folder / "right_*.png"), given)
        found = natural.recalibrate(replace(source, rig=turned(1.0, seed % 3))).calibration
        comparison = evaluate_truth(found, rig_json.read_truth(folder / "truth.json")).comparison
        scores += [p.error / p.sigma for p in comparison.parameters if p.name.startswith("rotation.")]
        assert comparison.rotation_error_deg < 0.1
    assert np.abs(scores).max() < 3
    assert np.sqrt(np.mean(np.square(scores))) < 1.4  # cameras are exact here, and stated as if they were not


def test_without_an_old_pose_and_with_a_baseline(folder, tmp_path):
    output = tmp_path / "new.json"
    arguments = ("--rig", folder / "turned.json", "--start", "none", "--baseline", "300mm", "--output", output)
    assert run("recalibrate", *sources(folder), *arguments) == 0
    new = rig_json.read_calibration(output)
    assert np.degrees(so3.angle_rad(new.rig.T_right_left.R @ T.R.T)) < 0.05
    assert new.rig.baseline_m == pytest.approx(0.3) and new.provenance["length_from"] == "--baseline"


def test_check_says_whether_the_rig_has_turned(folder, capsys):
    assert run("check", *sources(folder), "--rig", folder / "true.json") == 0
    assert capsys.readouterr().out.startswith("fine: ")
    assert run("check", *sources(folder), "--rig", folder / "turned.json") == 4
    out = capsys.readouterr().out
    assert out.startswith("drifted: pitch is +1.0") and "Depth" in out and "Rows" in out


def test_a_reference_is_what_check_compares_with(folder, tmp_path, capsys):
    """A published rig that is itself off is fine against its own recalibration, until it turns from there."""
    held = tmp_path / "held.json"
    assert run("recalibrate", *sources(folder), "--rig", folder / "turned.json", "--reference", "--output", held) == 0
    assert np.allclose(rig_json.read_rig(held).T_right_left.R, turned(1.0).T_right_left.R)
    capsys.readouterr()
    assert run("check", *sources(folder), "--rig", held, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["drift"]["against"] == "the file's own reference"
    damaged = json.loads(held.read_text())
    damaged["reference"]["R"] = [[1, 0], [0, 1]]
    held.write_text(json.dumps(damaged))
    assert run("check", *sources(folder), "--rig", held) == 3
    assert "reference is damaged" in capsys.readouterr().err


def test_wrong_images_are_named(folder, tmp_path, capsys):
    black = np.zeros(SIZE[::-1], np.uint8)
    for grey, side in enumerate(("left", "right")):
        cv2.imwrite(str(tmp_path / f"{side}_0.png"), black + np.uint8(grey))
    assert run("check", *sources(tmp_path), "--rig", folder / "true.json") == 3
    assert "0 points stand out" in capsys.readouterr().err
    for grey, side in enumerate(("left", "right")):
        cv2.imwrite(str(tmp_path / f"{side}_0.png"), black[:-10] + np.uint8(grey))
    assert run("check", *sources(tmp_path), "--rig", folder / "true.json") == 3
    assert "480x350 pixels, the rig's left camera has 480x360" in capsys.readouterr().err
    shutil.copy(folder / "left_00.png", tmp_path / "left_0.png")
    cv2.imwrite(str(tmp_path / "right_0.png"), cv2.imread(str(folder / "right_00.png"))[:, ::-1])
    assert run("check", *sources(tmp_path), "--rig", folder / "true.json") == 3
    assert "right_0.png is mirrored against" in capsys.readouterr().err
    two = tmp_path / "two"
    two.mkdir()
    for k, side in enumerate(("left", "right")):  # two scenes that have nothing in common
        shutil.copy(folder / f"left_{k:02d}.png", two / f"{side}_0.png")
    assert run("check", *sources(two), "--rig", folder / "true.json") == 3
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_blurred_and_black_images_are_named_or_left_out(folder, tmp_path, capsys):
    for side in ("left", "right"):
        for k in range(2):
            (tmp_path / f"{side}_{k}.png").write_bytes((folder / f"{side}_0{k}.png").read_bytes())
    sharp = cv2.imread(str(folder / "right_01.png"), cv2.IMREAD_GRAYSCALE)
    for spoiled, words in (
        (cv2.GaussianBlur(sharp, (0, 0), 1.5), "is blurred"),
        (np.zeros_like(sharp), "0 points stand out"),
    ):
        cv2.imwrite(str(tmp_path / "right_1.png"), spoiled)
        assert run("check", *sources(tmp_path), "--rig", folder / "true.json") == 0
        out = capsys.readouterr().out
        assert "1 of 2 pairs was left out" in out and "right_1.png" in out and words in out
        one = ["--left", tmp_path / "left_1.png", "--right", tmp_path / "right_1.png"]
        assert run("check", *one, "--rig", folder / "true.json") == 3
        err = capsys.readouterr().err
        assert words in err and "right_1.png" in err and len(err.strip().splitlines()) == 1


def test_simulate_makes_what_recalibrate_and_evaluate_take(tmp_path, capsys):
    rig = StereoRig(
        *(
            replace(c, size_wh=(240, 180), parameters=c.parameters * ([0.5] * 4 + [1] * 5))
            for c in (RIG.left, RIG.right)
        ),
        T,
    )
    rig_json.write_rig(tmp_path / "rig.json", rig)
    out = tmp_path / "out"
    arguments = [
        "simulate",
        "--rig",
        tmp_path / "rig.json",
        "--scene",
        "room",
        "--pairs",
        "1",
        "--output",
        out,
        "--gap",
        "10",
    ]
    assert run(*arguments, "--noise", "1", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["scene"] == "room" and document["gap_s"] == pytest.approx(0.01) and len(document["views"]) == 1
    assert sorted(path.name for path in out.iterdir()) == ["left_00.png", "right_00.png", "truth.json"]
    new = tmp_path / "new.json"
    assert run("recalibrate", *sources(out), "--rig", out / "truth.json", "--output", new) == 0
    capsys.readouterr()
    assert run("evaluate", new, "--truth", out / "truth.json", "--json") == 0
    assert json.loads(capsys.readouterr().out)["rotation_error_deg"] < 0.2
    assert run(*arguments) == 3 and "--force" in capsys.readouterr().err
    assert run(*arguments, "--force", "--seed", "1") == 0


def test_frames_that_tell_most_are_chosen(folder):
    source = natural.source_of_images(
        str(folder / "left_*.png"), str(folder / "right_*.png"), natural.load_given_rig(folder / "true.json")
    )
    run_of_one = natural.recalibrate(source, natural.NaturalOptions(max_pairs=1))
    assert len(run_of_one.calibration.views) == 1
    with pytest.raises(DataError, match="no pairs"):
        natural.recalibrate(natural.NaturalSource([], RIG))


def test_euroc_from_any_one_pair(data_dir):
    """Rotation within 0.05 deg and direction within 0.6 deg of sensor.yaml, within three stated standard deviations."""
    yaml = pytest.importorskip("yaml")
    mav = data_dir / "euroc_micro" / "mav0"
    cameras, poses = [], []
    for name in ("cam0", "cam1"):
        text = (mav / name / "sensor.yaml").read_text().replace("%YAML:1.0", "")
        sensor = yaml.safe_load(text)
        fu, fv, cu, cv = sensor["intrinsics"]
        K = np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1]])
        cameras.append(Camera.from_opencv(K, np.array(sensor["distortion_coefficients"]), tuple(sensor["resolution"])))
        poses.append(np.array(sensor["T_BS"]["data"]).reshape(4, 4))
    M = np.linalg.inv(poses[1]) @ poses[0]
    truth = SE3(so3.project_to_rotation(M[:3, :3]), M[:3, 3])
    rig = StereoRig(*cameras, truth)
    names = sorted(path.name for path in (mav / "cam0" / "data").glob("*.png"))[::5]
    for name in names:
        pair = StereoPair(name, mav / "cam0" / "data" / name, mav / "cam1" / "data" / name)
        found = natural.recalibrate(natural.NaturalSource([pair], rig), natural.NaturalOptions(from_old_rig=False))
        new, sigma = found.calibration.rig.T_right_left, found.calibration.covariance.sigma
        turn = so3.log(new.R @ truth.R.T)
        cosine = new.t @ truth.t / np.linalg.norm(new.t) / np.linalg.norm(truth.t)
        assert np.degrees(np.linalg.norm(turn)) < 0.05  # measured 0.021 to 0.036
        assert np.degrees(np.arccos(min(cosine, 1.0))) < 0.6  # measured 0.02 to 0.37
        assert np.abs(turn / [sigma[f"rotation.{a}"] for a in "xyz"]).max() < 3
        assert found.after.median_px < 0.1


@pytest.mark.parametrize(("pair", "yaw_deg"), [("gray", (0.28, 0.48)), ("colour", (0.05, 0.2))])
def test_kitti_from_any_one_frame(data_dir, pair, yaw_deg):
    """The rectified calibration is off in yaw; a turned rig comes to the same result, and small turns are called."""
    folder = data_dir / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0002_sync"
    source = natural.source_of_dataset(f"kitti:{folder}:{pair}", None)
    others = natural.recalibrate(replace(source, pairs=source.pairs[1:]))
    reference = natural.reference_document(others.calibration)
    one = replace(source, pairs=source.pairs[:1], reference=reference)
    found = natural.recalibrate(replace(one, reference=None))
    assert yaw_deg[0] < abs(found.drift.turn_deg[1]) < yaw_deg[1]
    assert np.abs(found.drift.turn_deg[[0, 2]]).max() < 0.05
    assert found.after.median_px < 0.075 < found.before.median_px
    assert not natural.recalibrate(one).drift.is_sure
    for axis, deg in ((0, 0.1), (1, 0.5), (2, 0.1)):
        turn = so3.exp(np.radians(deg) * np.eye(3)[axis])
        moved = StereoRig(
            source.rig.left, source.rig.right, SE3(turn @ source.rig.T_right_left.R, source.rig.T_right_left.t)
        )
        again = natural.recalibrate(replace(one, rig=moved, reference=None))
        assert np.allclose(again.calibration.rig.T_right_left.R, found.calibration.rig.T_right_left.R, atol=1e-4)
        turned_reference = {**reference, "R": (turn @ np.array(reference["R"])).tolist()}
        assert natural.recalibrate(replace(one, reference=turned_reference)).drift.is_sure


def test_a_data_set_brings_its_cameras(data_dir, capsys):
    assert run("check", "--dataset", f"middlebury:{data_dir / 'middlebury2021'}") == 0
    assert "Matches" in capsys.readouterr().out
    assert run("check", "--dataset", "kitti:/nowhere") == 3
    assert run("check") == 2


def euroc_of(folder, path):
    """The first pair of the folder in EuRoC's layout, the left camera as the body."""
    for k, (camera, T_body, side) in enumerate(((RIG.left, SE3.identity(), "left"), (RIG.right, T.inverse(), "right"))):
        cam = path / "mav0" / f"cam{k}"
        (cam / "data").mkdir(parents=True)
        shutil.copy(folder / f"{side}_00.png", cam / "data" / "1403715273262142976.png")
        matrix = np.vstack([np.column_stack([T_body.R, T_body.t]), [0, 0, 0, 1]])
        (cam / "sensor.yaml").write_text(
            f"T_BS:\n  data: {matrix.ravel().tolist()}\nrate_hz: 20\nresolution: {list(SIZE)}\ncamera_model: pinhole\n"
            f"intrinsics: {camera.parameters[:4].tolist()}\ndistortion_model: radial-tangential\n"
            f"distortion_coefficients: {camera.parameters[5:].tolist()}\n"
        )
    return f"euroc:{path}"


def test_a_data_set_keeps_its_own_rig_with_a_reference(folder, tmp_path, capsys):
    """No --rig: the cameras and the pose are the data set's, and `check` finds the reference in what was written."""
    dataset, held = euroc_of(folder, tmp_path / "set"), tmp_path / "held.json"
    assert run("recalibrate", "--dataset", dataset, "--reference", "--output", held) == 0
    kept = rig_json.read_calibration(held)
    assert np.allclose(kept.rig.T_right_left.R, T.R) and kept.provenance["length_from"] == "T_BS in sensor.yaml, metres"
    capsys.readouterr()
    assert run("check", "--dataset", dataset, "--rig", held, "--json") == 0
    assert json.loads(capsys.readouterr().out)["drift"]["against"] == "the file's own reference"
    assert run("check", "--dataset", dataset, "--rig-of", "2021") == 3
    assert "no pair is called 2021" in capsys.readouterr().err
    assert run("check", *sources(folder), "--rig", held, "--rig-of", "2021") == 2


def test_check_sees_a_translation_that_points_elsewhere(folder, tmp_path, capsys):
    """Rows are off by pixels then, though no angle has moved."""
    swung = so3.exp(np.radians([0.0, 0.0, 10.0])) @ T.t
    path = tmp_path / "swung.json"
    rig_json.write_rig(path, StereoRig(RIG.left, RIG.right, SE3(T.R, swung)))
    assert run("check", *sources(folder), "--rig", path, "--json") == 4
    document = json.loads(capsys.readouterr().out)
    assert document["drift"]["has_drifted"] and document["drift"]["direction_of_T_deg"] == pytest.approx(10, abs=1.5)
    assert document["drift"]["direction_of_T_sigma_deg"] < 2.5
    assert run("check", *sources(folder), "--rig", path) == 4
    assert capsys.readouterr().out.startswith(("drifted: the translation points", "drifted: rows are off"))


def test_single_pairs_against_each_others_reference_are_called_fine(data_dir):
    """KITTI's grey frames differ in pitch by more than their matches' errors say: 2 of 20 were called drifted."""
    folder = data_dir / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0002_sync"
    source = natural.source_of_dataset(f"kitti:{folder}:gray", None)
    for first, second in ((0, 3), (3, 0)):
        own = natural.recalibrate(replace(source, pairs=[source.pairs[first]]))
        reference = natural.reference_document(own.calibration)
        run = natural.recalibrate(replace(source, pairs=[source.pairs[second]], reference=reference))
        assert not run.has_drifted


def test_images_without_a_partner_are_named(folder, tmp_path, capsys):
    for path in sorted(folder.glob("*.png"))[:-1]:
        (tmp_path / path.name).symlink_to(path)
    assert run("check", *sources(tmp_path), "--rig", folder / "true.json", "--json") in (0, 4)
    (said,) = [f for f in json.loads(capsys.readouterr().out)["findings"] if f["code"] == "dataset-frames-left-out"]
    assert "1 image has no partner" in said["text"]


@pytest.mark.parametrize(("length_m", "text"), [(0.0, "translation is zero"), (1.2e5, "1 mm to 100 m")])
def test_rigs_that_cannot_be_are_named(folder, tmp_path, capsys, length_m, text):
    rig_json.write_rig(tmp_path / "rig.json", StereoRig(RIG.left, RIG.right, SE3(T.R, length_m * T.t)))
    assert run("check", *sources(folder), "--rig", tmp_path / "rig.json") == 3
    assert text in capsys.readouterr().err
    arguments = ["--rig", folder / "turned.json", "--output", tmp_path / "o.json", "--baseline", "1e9m"]
    assert run("recalibrate", *sources(folder), *arguments) == 2
    assert "1 mm to 100 m" in capsys.readouterr().err
