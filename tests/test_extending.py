"""The page on extending runs: its package is installed for the test, and what it adds keeps every contract."""

from __future__ import annotations

import re
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import binocal
from binocal import plugins
from binocal.calibrators import CALIBRATORS, known_calibrators, load_calibrator
from binocal.cameras import camera_model, known_camera_models
from binocal.cli import main
from binocal.errors import PluginError
from binocal.formats import rig_json
from binocal.formats.registry import known_formats, load_format
from binocal.formats.rig_file import load_rig
from binocal.metrics.image import pixel_error
from binocal.metrics.order import order_corners
from binocal.metrics.pose import in_model
from binocal.rectification import rectify
from binocal.solvers.covariance import cramer_rao_bound
from contracts import (
    BOARD_CONTRACT,
    CALIBRATOR_CONTRACT,
    CAMERA_CONTRACT,
    foreign_content_is_not_taken_for_its_own,
    make_corners,
    make_rigs,
    result_comes_back_from_its_file,
    what_is_written_comes_back_but_for_the_losses,
)
from rigs import assert_same_rig, make_detections, make_poses, make_rig

PAGE = Path(__file__).resolve().parents[1] / "docs" / "extending.md"
BLOCKS = re.findall(r"```(\w+)\n# ([\w.]+)[^\n]*\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def install(folder: Path, entry_points: dict[str, dict[str, str]], modules: dict[str, str]) -> None:
    """What pip leaves of a package: its modules and a dist-info."""
    for name, text in modules.items():
        (folder / name).write_text(text)
    info = folder / "binocal_examples-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: binocal-examples\nVersion: 1.0\n")
    groups = (
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in names.items())
        for group, names in entry_points.items()
    )
    (info / "entry_points.txt").write_text("\n".join(groups))


@pytest.fixture
def add_package(tmp_path, monkeypatch):
    """Installs a package for the test, and forgets it after."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setattr(plugins, "_loaded", {})
    before = set(sys.modules)
    yield lambda entry_points, modules: install(folder, entry_points, modules)
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and Path(sys.modules[name].__file__).parent == folder:
            del sys.modules[name]


@pytest.fixture
def examples(add_package):
    (toml,) = (text for language, name, text in BLOCKS if name == "pyproject.toml")
    modules = {name: text for language, name, text in BLOCKS if language == "python"}
    add_package(tomllib.loads(toml)["project"]["entry-points"], modules)


def test_each_example_is_short():
    lengths = {name: text.count("\n") for language, name, text in BLOCKS if language == "python"}
    assert set(lengths) == {"trimmed.py", "stereo_toml.py", "division.py"} and max(lengths.values()) <= 45


def test_what_is_added_is_listed_after_what_is_built_in(examples):
    assert known_calibrators() == (*CALIBRATORS, "trimmed")
    assert known_formats() == ("binocal", "opencv", "stereo-toml")
    assert known_camera_models() == ("brown4", "brown5", "brown8", "fisheye4", "division1")
    assert not {"trimmed", "stereo_toml", "division"} & set(sys.modules)  # listing imports nothing
    for ask, name in ((load_calibrator, "trimmed"), (load_format, "stereo-toml"), (camera_model, "division1")):
        with pytest.raises(ValueError, match=name):
            ask("no such thing")


@pytest.mark.parametrize("check", (*CALIBRATOR_CONTRACT, *BOARD_CONTRACT), ids=lambda check: check.__name__)
def test_the_calibrator_keeps_the_contract(examples, check):
    check("trimmed")


def test_the_calibrator_does_what_the_page_says(examples, tmp_path):
    result_comes_back_from_its_file("trimmed", tmp_path)
    detections = make_corners(10)
    noisy = detections.right_px.copy()
    noisy[4] += 0.5 * np.random.default_rng(0).standard_normal(noisy[4].shape)
    calibration = binocal.calibrate(
        replace(detections, right_px=noisy), calibrator="trimmed", model="brown4", options={"factor": 1.5}
    )
    assert [view.name for view in calibration.rejected] == ["4"] and "median view" in calibration.rejected[0].reason
    assert calibration.provenance["options"]["factor"] == 1.5 and calibration.provenance["calibrator"] == "trimmed"


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_format_keeps_the_contract(examples, tmp_path):
    (tmp_path / "rigs").mkdir()
    what_is_written_comes_back_but_for_the_losses("stereo-toml", tmp_path / "rigs")
    foreign_content_is_not_taken_for_its_own("stereo-toml", tmp_path, ("binocal", "opencv"))
    rig = make_rigs()[0]
    load_format("stereo-toml").write(tmp_path / "rig.txt", rig)
    assert_same_rig(load_rig(tmp_path / "rig.txt"), rig)


@pytest.mark.parametrize("check", CAMERA_CONTRACT, ids=lambda check: check.__name__)
def test_the_camera_model_keeps_the_contract(examples, check):
    check("division1")


def test_a_rig_of_the_added_model_is_good_for_all_but_solving(examples, tmp_path):
    ordinary = make_rig()
    rig = replace(
        ordinary,
        **{
            side: binocal.Camera("division1", (1280, 960), np.r_[getattr(ordinary, side).parameters[:5], -0.15])
            for side in ("left", "right")
        },
    )
    rig_json.write_rig(tmp_path / "rig.json", rig)
    assert_same_rig(load_rig(tmp_path / "rig.json"), rig)
    detections = make_detections(
        rig, make_poses(5, np.random.default_rng(0)), noise_px=0.1, rng=np.random.default_rng(1)
    )
    ordered = order_corners(rig, detections)
    error = pixel_error(rig, ordered.detections, ordered.T_left_board)
    assert 0.12 < error.all_px < 0.15  # sqrt(2) times the noise, less what five poses take up
    assert rectify(rig).P_left[0, 0] > 0
    assert in_model(rig.left, "division1") is not None and in_model(rig.left, "brown4") is None  # another k1
    bound = cramer_rao_bound(rig, detections.object_points_m, ordered.T_left_board, 0.1)
    assert 0 < bound.sigma["left.k1"] < 0.01 and len(bound.names) == 6 + 2 * 5
    with pytest.raises(binocal.DataError, match="division1"):
        load_format("opencv").write(tmp_path / "rig.yml", rig)
    with pytest.raises(ValueError, match="'division1' cannot be solved with: the compiled solver knows brown4"):
        binocal.calibrate(detections, model="division1")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("raise RuntimeError('no licence')", "broken:thing fails to load: RuntimeError: no licence"),
        ("other = 1", "broken:thing fails to load: AttributeError"),
        ("thing = 3", "broken:thing is a int, not"),
    ],
)
def test_an_entry_point_that_fails_is_named_with_its_package(add_package, capsys, text, expected):
    groups = (plugins.CALIBRATORS, plugins.FORMATS, plugins.CAMERA_MODELS)
    add_package({group: {"broken": "broken:thing"} for group in groups}, {"broken.py": text})
    for ask in (load_calibrator, load_format, camera_model):
        with pytest.raises(PluginError, match=re.escape(expected)) as caught:
            ask("broken")
        assert caught.value.package == "binocal-examples" and "uninstall" in str(caught.value)
    arguments = ["calibrate", "--left", "l", "--right", "r", "--board", "chessboard:9x6", "--calibrator", "broken"]
    assert main(arguments) == 1
    err = capsys.readouterr().err
    assert err.startswith("binocal: 'broken' (binocal.calibrators)") and err.count("\n") == 1


def test_a_record_must_bear_the_name_of_its_entry_point(add_package):
    module = "from binocal.cameras import CAMERA_MODELS\nmodel = CAMERA_MODELS['brown4']\n"
    add_package({plugins.CAMERA_MODELS: {"other": "renamed:model"}}, {"renamed.py": module})
    with pytest.raises(PluginError, match="calls itself 'brown4'"):
        camera_model("other")


def test_what_is_built_in_never_looks_for_entry_points(monkeypatch):
    monkeypatch.setattr(plugins, "load_plugin", lambda *_: pytest.fail("looked up"))
    monkeypatch.setattr(plugins, "plugin_names", lambda *_: pytest.fail("listed"))
    load_calibrator("lm"), load_format("opencv"), camera_model("brown4")
    binocal.calibrate(make_corners(), model="brown4")
