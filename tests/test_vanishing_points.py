"""From images of rooms to a focal length, a verdict on a rig, and an exit code; real images where they are at hand."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from binocal.app.scene_lines import SceneOptions as LineOptions
from binocal.app.scene_lines import calibrate_scene
from binocal.cameras import Camera, StereoRig
from binocal.cli import main
from binocal.datasets import open_dataset
from binocal.errors import CancelledError
from binocal.formats import rig_json
from binocal.geometry import SE3
from binocal.simulation import SceneOptions, draw_textured_scene, render_scene_image
from rooms import frame, render_room

SIZE = (480, 360)
T = SE3(np.eye(3), np.array([-0.1, 0.0, 0.0]))


def camera(f=390.0, k1=-0.2):
    return Camera("brown4", SIZE, np.array([f, 1.1 * f, 244, 177, 0, k1, 0, 0, 0]))


def write_room(path, taken_by, turn, seed=0):
    cv2.imwrite(str(path), render_room(taken_by, frame(*turn), seed=seed))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("room")
    for k, turn in enumerate(((40.0, 20.0), (25.0, -18.0))):
        write_room(path / f"room_{k}.png", camera(), turn, seed=k)
        square = Camera("brown4", SIZE, np.array([390.0, 390, 244, 177, 0, -0.2, 0, 0, 0]))
        write_room(path / f"square_{k}.png", square, turn, seed=k)
    rig_json.write_rig(path / "true.json", StereoRig(camera(), camera(), T))
    rig_json.write_rig(
        path / "wrong.json", StereoRig(camera(), replace(camera(), parameters=camera(460.0).parameters), T)
    )
    return path


def run(*arguments):
    try:
        return main([str(a) for a in arguments])
    except SystemExit as error:
        return error.code


def test_a_rig_is_checked_and_a_wrong_one_is_called_so(folder, capsys):
    images = ["vanishing-points", "--images", folder / "room_*.png", "--rig"]
    assert run(*images, folder / "true.json", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["check"]["agrees"] and abs(said["check"]["f"]["z"]) < 4
    assert said["f_px"] == pytest.approx(390, abs=3 * said["sigma_px"]["f"] + 1) and said["assumed"]["square_pixels"]
    assert said["assumed"]["principal_point_px"] == pytest.approx([239.5, 179.5])  # in the image's own rows
    assert run(*images, folder / "true.json") == 0
    assert capsys.readouterr().out.startswith("agrees: ")
    assert run(*images, folder / "wrong.json", "--side", "right") == 4
    assert capsys.readouterr().out.startswith("contradicts: ")


def test_a_lens_nobody_knows_is_taken_out_and_said_so(folder):
    found = calibrate_scene(str(folder / "square_*.png"))
    assert found.lens == "one coefficient, from bent lines" and found.check is None
    assert [f.code for f in found.intrinsics.findings] == ["lens-from-bent-lines"]
    assert found.intrinsics.focal_px == pytest.approx(390, abs=4 * found.intrinsics.covariance.sigma["f"])


def test_wrong_input_is_one_line(folder, tmp_path, capsys):
    assert run("vanishing-points", "--images", tmp_path / "none_*.png") == 3
    cv2.imwrite(str(tmp_path / "a.png"), np.full((360, 480), 90, np.uint8))
    assert run("vanishing-points", "--images", tmp_path / "a.png") == 3
    assert "straight edges" in capsys.readouterr().err
    cv2.imwrite(str(tmp_path / "b.png"), np.full((240, 320), 90, np.uint8))
    assert run("vanishing-points", "--images", tmp_path / "*.png") == 3
    assert "b.png: 320x240 pixels" in capsys.readouterr().err
    assert run("vanishing-points", "--images", tmp_path / "b.png", "--rig", folder / "true.json") == 3
    assert "the rig's left camera has 480x360" in capsys.readouterr().err
    noise = np.random.default_rng(0).integers(0, 256, (360, 480)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "c.png"), cv2.GaussianBlur(noise, (0, 0), 3))
    assert run("vanishing-points", "--images", tmp_path / "c.png", "--json") == 3
    assert "lines-" in capsys.readouterr().out


def test_a_wall_seen_face_on_tells_nothing(tmp_path, capsys):
    narrow = Camera("brown4", SIZE, np.array([680.0, 680, 239.5, 179.5, 0, 0, 0, 0, 0]))
    cv2.imwrite(str(tmp_path / "wall.png"), render_room(narrow, np.eye(3), tile_m=0.3))
    assert run("vanishing-points", "--images", tmp_path / "wall.png") == 3


def test_the_simulators_room_tells_its_camera(tmp_path):
    """Window frames, tiles and shelves in three directions, seen to either side; measured 270.1 ± 2.8."""
    plain = Camera("brown4", (400, 300), np.array([270.0, 270, 199.5, 149.5, 0, 0, 0, 0, 0]))
    scene = draw_textured_scene("room", StereoRig(plain, plain, T), 2, np.random.default_rng(0))
    for k in range(2):
        options, rng = SceneOptions(0.7, noise_dn=1.0), np.random.default_rng(k)
        cv2.imwrite(
            str(tmp_path / f"{k}.png"), render_scene_image(scene, k, plain, scene.T_left_world[k], options, rng)
        )
    found = calibrate_scene(str(tmp_path / "*.png")).intrinsics
    assert found.values[0] == pytest.approx(270, abs=2) and found.covariance.sigma["f"] < 6


def test_a_run_can_be_stopped(folder):
    with pytest.raises(CancelledError):
        calibrate_scene(str(folder / "room_*.png"), LineOptions(should_stop=lambda: True))


@pytest.mark.slow
@pytest.mark.data
def test_real_streets_and_gardens_are_refused_rather_than_guessed(data_dir, capsys):
    """KITTI's streets are seen along, its focal length is untold; gardens have no families."""
    for side in ("left", "right"):
        pairs = open_dataset(f"kitti:{data_dir / 'kitti_raw'}").by_rig()[0].stereo_pairs
        folder = getattr(pairs[0], f"{side}_path").parent
        assert run("vanishing-points", "--images", folder) == 3
    for name in ("garden02", "stones01", "sundial01", "lantern01"):
        assert run("vanishing-points", "--images", data_dir / "boof_bumblebee2_scenes" / f"{name}_left.jpg") == 3
