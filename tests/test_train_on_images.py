"""From a folder of images to an agent of one's own, and a rig calibrated with it."""

import json
from importlib.resources import files

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs the train extra")

from binocal import app
from binocal.boards import parse_board
from binocal.cli import main
from binocal.errors import DataError, TooFewViewsError
from binocal.formats import rig_json
from binocal.geometry import SE3
from binocal.simulation import table2_rig

BOARD = parse_board("chessboard:8x5:20mm")


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    app.simulate(table2_rig(), BOARD, 14, folder, force=True)
    return folder


@pytest.mark.slow
def test_half_of_the_images_trains_and_the_other_half_evaluates(images, tmp_path, capsys):
    arguments = ["train", "--data", str(images), "--output", str(tmp_path / "agent")]  # truth.json names the board
    assert main([*arguments, "--steps", "3000", "--rigs", "12"]) == 0
    out = capsys.readouterr().out
    rows = json.loads((tmp_path / "agent" / "table.json").read_text())
    assert {row["set_name"] for row in rows} == {"second half"} and {row["n_rigs"] for row in rows} == {12}
    assert {"drl", "drl, as shipped", "LM-Marquardt"} <= {row["controller"] for row in rows}
    assert "second half" in out and "drl, as shipped" in out and "second half: baseline" in out
    card = (tmp_path / "agent" / "card.md").read_text()
    assert "7 pairs of real images" in card and "actor [16]" in card and "from the images of the second half" in card

    weights = str(tmp_path / "agent" / "weights.safetensors")
    arguments = ["calibrate", "--left", str(images / "left*"), "--right", str(images / "right*"), "--model", "brown4"]
    arguments += ["--board", "chessboard:8x5:20mm"]
    rigs = []
    for name in (weights, "lm"):
        output = tmp_path / "rig.json"
        assert main([*arguments, "--calibrator", name, "--output", str(output), "--force"]) == 0
        rigs.append(json.loads(output.read_text()))
    np.testing.assert_allclose(*(rig["T"] for rig in rigs), rtol=1e-6, atol=1e-9)
    assert rigs[0]["provenance"]["calibrator"] == weights and "agent" in rigs[0]["provenance"]


@pytest.mark.slow
def test_too_few_images_are_said_before_any_training(images, tmp_path):
    few = tmp_path / "few"
    few.mkdir()
    for side in ("left", "right"):
        for i in range(8):
            (few / f"{side}_{i:02d}.png").write_bytes((images / f"{side}_{i:02d}.png").read_bytes())
    with pytest.raises(TooFewViewsError, match="12"):
        app.train(tmp_path / "agent", app.TrainRequest(n_steps=100), data=few, board=BOARD)


def test_a_folder_says_which_board_it_shows(tmp_path):
    with pytest.raises(DataError, match=r"which board.*none"):
        app.board_of_folder(tmp_path)
    (tmp_path / "camera.yaml").write_text("fx: 3")
    (tmp_path / "target.yaml").write_text("board: chessboard:8x5:20mm")
    assert app.board_of_folder(tmp_path) == BOARD
    (tmp_path / "other.yml").write_text("board: chessboard:9x5:20mm")
    with pytest.raises(DataError, match=r"more than one \(other\.yml, target\.yaml\)"):
        app.board_of_folder(tmp_path)


def test_images_of_a_street_show_no_board(tmp_path):
    rig_json.write_truth(
        tmp_path / "truth.json",
        rig_json.Truth(table2_rig(), None, ("0",), SE3(np.eye(3)[None], np.zeros((1, 3))), scene="street"),
    )
    with pytest.raises(DataError, match="show no board"):
        app.board_of_folder(tmp_path)


def test_a_run_that_cannot_begin_leaves_the_former_one_alone(tmp_path):
    agent = tmp_path / "agent"
    agent.mkdir()
    (agent / "checkpoint.pt").write_bytes(b"former")
    (agent / "weights.safetensors").write_bytes((files("binocal.rl") / "weights" / "drl.safetensors").read_bytes())
    with pytest.raises(DataError):
        app.train(agent, data=tmp_path, board=BOARD, force=True)
    assert (agent / "checkpoint.pt").read_bytes() == b"former"
    with pytest.raises(DataError):
        app.train(tmp_path / "new", data=tmp_path, board=BOARD)
    with pytest.raises(DataError, match="holds no training run"):
        app.train(tmp_path / "new", beside=[agent])
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("content", [None, b"no weights"])
def test_weights_that_cannot_be_read_are_named_before_any_image_is(tmp_path, capsys, content):
    weights = tmp_path / "mine.safetensors"
    if content is not None:
        weights.write_bytes(content)
    arguments = [
        "calibrate",
        "--left",
        "l",
        "--right",
        "r",
        "--board",
        "chessboard:8x5:20mm",
        "--calibrator",
        str(weights),
    ]
    assert main(arguments) == 3
    assert capsys.readouterr().err.startswith(f"binocal: {weights}: ")
