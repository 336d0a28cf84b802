from __future__ import annotations

import json
import os
import warnings
from pathlib import Path

import pytest

from binocal import app, errors
from binocal.boards import Board
from binocal.cameras import CAMERA_MODELS
from binocal.cli import main
from binocal.cli.verbs.calibrate import Model
from binocal.formats import rig_json
from binocal.formats.detections_npz import read_detections
from fakes import FakePackages
from rigs import make_rig

CALIBRATE = ["calibrate", "--left", "l/*.png", "--right", "r/*.png", "--board", "chessboard:11x8:10mm"]


@pytest.fixture
def fakes(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    return FakePackages(monkeypatch)


def one_document(capsys) -> dict:
    """The one JSON document on stdout, without NaN."""
    return json.loads(capsys.readouterr().out, parse_constant=lambda word: pytest.fail(f"{word} on stdout"))


def test_models_are_the_registry():
    assert [model.value for model in Model] == ["auto", *CAMERA_MODELS]


def test_calibrate_writes_the_rig_and_a_summary(fakes, capsys):
    assert main([*CALIBRATE, "--output", "new/rig.json"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("warning: left and right look exchanged")
    assert "yaw" in out and "baseline" in out and "Views    6 used, 1 dropped" in out
    assert "view 07: no board found in the right image" in out and "Wrote    new/rig.json" in out
    assert "ignored file left99 copy.png: a copy of left99.png" in err and "dropped view 07: no board found" in err
    assert rig_json.read_rig("new/rig.json").baseline_m == pytest.approx(fakes.rig.baseline_m)
    assert os.listdir("new") == ["rig.json"]


def test_json_is_exactly_one_document(fakes, capsys):
    assert main([*CALIBRATE, "--json"]) == 0
    document = one_document(capsys)
    assert document["schema"] == "binocal/1" and document["output"] == "rig.json" and len(document["views"]) == 6
    assert document["ignored"][0]["path"] == "left99 copy.png" and document["quality"]["is_met"] is True


def test_options_reach_the_calibrator(fakes, capsys):
    assert main([*CALIBRATE, "--model", "brown5", "--skew", "--seed", "3", "--preprocess"]) == 0
    request = fakes.calls["calibrate"]
    assert (request.model, request.skew, request.seed) == ("brown5", True, 3) and fakes.calls["calibrator"] == "drl"
    assert fakes.calls["preprocess"] is True


def test_nothing_is_overwritten_and_no_work_is_lost(fakes, capsys, tmp_path):
    (tmp_path / "rig.json").write_text("old")
    assert main(CALIBRATE) == 3
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and "--force" in err and "list_pairs" not in fakes.calls
    assert (tmp_path / "rig.json").read_text() == "old"
    assert main([*CALIBRATE, "--force"]) == 0


def test_below_the_quality_asked_for(fakes, capsys):
    assert main([*CALIBRATE, "--max-rms", "0.1"]) == 4
    assert "above --max-rms 0.1" in capsys.readouterr().out and os.path.exists("rig.json")
    assert main([*CALIBRATE, "--max-rms", "0.2", "--force"]) == 0


def test_evidence_beside(fakes, capsys):
    assert main([*CALIBRATE, "--evidence", "new/corners.npz"]) == 0
    assert "Wrote    rig.json and new/corners.npz" in capsys.readouterr().out
    back = read_detections("new/corners.npz")
    assert back.names == fakes.detections.names and back.board_spec == "chessboard:11x8:10mm"
    assert (back.left_px == fakes.detections.left_px).all()
    assert main([*CALIBRATE, "--output", "b.json", "--evidence", "new/corners.npz"]) == 3 and not os.path.exists(
        "b.json"
    )
    assert main([*CALIBRATE, "--output", "b.json", "--evidence", "b.json"]) == 2
    assert "same file" in capsys.readouterr().err
    assert main([*CALIBRATE, "--force", "--evidence", "new/corners.npz", "--json"]) == 0
    assert one_document(capsys)["evidence"] == "new/corners.npz"


def test_opencv_beside(fakes, capsys):
    assert main([*CALIBRATE, "--opencv", "rig.yml"]) == 0
    assert main([*CALIBRATE, "--force", "--opencv", "rig.yml", "--skew"]) == 2
    assert main([*CALIBRATE, "--output", "b.json", "--opencv", "rig.yml"]) == 3 and not os.path.exists("b.json")
    assert "skew" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "exit_code", "code"),
    [
        (errors.TooFewViewsError(2, 3, {"05": "mismatched pair"}), 3, "too-few-views"),
        (errors.DetectionError("no board in any image.", {"01": "too dark"}), 3, "detection"),
        (errors.FormatError("left01.png", "truncated"), 3, "format"),
        (errors.NotConvergedError("the solver stopped at\na saddle."), 1, "not-converged"),
        (errors.MissingExtraError("training", "train"), 1, "missing-extra"),
        (errors.CancelledError("stopped as asked."), 130, "cancelled"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_every_error_is_one_line_and_one_document(fakes, capsys, error, exit_code, code):
    def fail(*_, **__):
        raise error

    fakes.calibrate = fail
    assert main(CALIBRATE) == exit_code
    out, err = capsys.readouterr()
    assert out == "" and "Traceback" not in err and err.splitlines()[-1].startswith("binocal: ")
    assert main([*CALIBRATE, "--json"]) == exit_code
    document = one_document(capsys)
    assert document["error"]["code"] == code and "\n" not in document["error"]["message"]
    assert os.listdir() == []


def test_an_error_lists_what_was_dropped(fakes, capsys):
    def fail(*_, **__):
        raise errors.TooFewViewsError(2, 3, {"05": "mismatched pair"})

    fakes.calibrate = fail
    main([*CALIBRATE, "--json"])
    out, err = capsys.readouterr()
    error = json.loads(out)["error"]
    assert error["rejected"] == {"07": "no board found in the right image", "05": "mismatched pair"}
    assert (
        error["found"] == 2
        and error["needed"] == 3
        and error["notes"]
        == [
            "ignored left99 copy.png: a copy of left99.png",
            "note: left and right images differ in size",
        ]
    )
    assert err.splitlines()[:4] == [
        "ignored file left99 copy.png: a copy of left99.png",
        "dropped view 07: no board found in the right image",
        "dropped view 05: mismatched pair",
        "note: left and right images differ in size",
    ]


def test_equal_reasons_share_a_line(fakes, capsys):
    def fail(*_, **__):
        raise errors.DetectionError("no board in any image.", {f"left{i:02d}.png": "too dark" for i in range(88)})

    fakes.calibrate = fail
    main(CALIBRATE)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("dropped")]
    assert lines == [f"dropped 88 images ({', '.join(f'left{i:02d}.png' for i in range(8))} and 80 more): too dark"]


@pytest.mark.filterwarnings("default")
def test_numpys_warnings_are_not_the_users(fakes, capsys):
    calibrate = fakes.calibrate

    def warn(*args, **kwargs):
        warnings.warn("invalid value encountered in log", RuntimeWarning, stacklevel=2)
        warnings.warn("this the user should know", stacklevel=2)
        return calibrate(*args, **kwargs)

    fakes.calibrate = warn
    main(CALIBRATE)
    err = capsys.readouterr().err
    assert "encountered" not in err and "warning: this the user should know" in err


def test_a_bug_is_not_dressed_up(fakes, capsys):
    def fail(*_, **__):
        raise ZeroDivisionError("a bug")

    fakes.calibrate = fail
    with pytest.raises(ZeroDivisionError):
        main([*CALIBRATE, "--json"])
    assert one_document(capsys)["error"]["code"] == "internal"


@pytest.mark.parametrize(
    "arguments",
    [
        ["nope"],
        ["calibrate"],
        [*CALIBRATE, "--model", "brown9"],
        [*CALIBRATE, "--calibrator", "magic"],
        [*CALIBRATE, "--max-rms", "-1"],
        [*CALIBRATE[:-1], "chess"],
        ["simulate", "--board", "chessboard:11x8", "--pairs", "2", "--output", "out"],
        ["simulate", "--board", "chessboard:11x8:10mm", "--pairs", "0", "--output", "out"],
        ["simulate", "--pairs", "2", "--output", "out"],
        ["simulate", "--board", "chessboard:11x8:10mm", "--scene", "street", "--pairs", "2", "--output", "out"],
        ["simulate", "--board", "chessboard:11x8:10mm", "--gap", "5", "--pairs", "2", "--output", "out"],
        ["simulate", "--scene", "moon", "--pairs", "2", "--output", "out"],
        ["evaluate", "rig.json"],
        ["evaluate", "rig.json", "--truth", "t.json", "--left", "l"],
        ["evaluate", "rig.json", "--left", "l", "--right", "r"],
        ["bench", "nope"],
    ],
)
def test_wrong_usage(fakes, capsys, arguments):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and "--help" in err
    if arguments != ["nope"]:
        assert main([*arguments, "--json"]) == 2
        assert one_document(capsys)["error"]["code"] == "usage"
    assert os.listdir() == []


def test_without_arguments_help_is_shown(capsys):
    assert main([]) == 2 and "calibrate" in capsys.readouterr().out
    assert main(["--help"]) == 0 and "Exit codes" in capsys.readouterr().out
    assert main(["--version"]) == 0 and capsys.readouterr().out.startswith("binocal ")


def test_simulate_then_evaluate_against_the_truth(fakes, capsys):
    assert main(["simulate", "--board", "chessboard:11x8:10mm", "--pairs", "6", "--output", "out"]) == 0
    assert "6 pairs" in capsys.readouterr().out
    assert main(CALIBRATE) == 0
    capsys.readouterr()
    assert main(["evaluate", "rig.json", "--truth", "out/truth.json"]) == 0
    out = capsys.readouterr().out
    assert "parameters within tolerance (eq. 20): 22 of 22, 100 %" in out
    for criterion in ("rotation error", "translation error", "pixel error", "rectified row error", "length error"):
        assert criterion in out
    assert main(["evaluate", "rig.json", "--truth", "out/truth.json", "--json"]) == 0
    assert one_document(capsys)["parameter_accuracy_percent"] == 100


def test_simulate_takes_a_rig_file_and_says_what_it_did(fakes, capsys):
    rig_json.write_calibration("rig.json", app.calibrate_images("l", "r", Board.from_spec(CALIBRATE[-1])).calibration)
    arguments = ["simulate", "--rig", "rig.json", "--board", "chessboard:11x8:10mm", "--pairs", "2", "--output", "out"]
    assert main([*arguments, "--json"]) == 0
    document = one_document(capsys)
    assert len(document["views"]) == 2 and document["noise_dn"] == 3.0 and document["output"] == "out"
    assert main(arguments) == 3 and "--force" in capsys.readouterr().err
    assert main([*arguments[:2], "no.json", *arguments[3:], "--force"]) == 3


def test_evaluate_on_images(fakes, capsys):
    rig_json.write_calibration("rig.json", app.calibrate_images("l", "r", Board.from_spec(CALIBRATE[-1])).calibration)
    arguments = ["evaluate", "rig.json", *CALIBRATE[1:]]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "relative length error (RMS)" in out and "rectified row error (RMS)" in out and "1 dropped" in out
    assert main([*arguments, "--json"]) == 0
    assert one_document(capsys)["relative_length_error_percent"]["rms"] < 1e-6


@pytest.mark.slow
def test_demo(fakes, capsys):
    assert main(["demo", "--output", "demo"]) == 0
    out = capsys.readouterr().out
    assert "10mm board: 6 pairs" in out and "20mm board" in out and "left.fx px" in out
    assert main(["demo", "--output", "demo"]) == 3
    capsys.readouterr()
    assert main(["demo", "--output", "demo", "--force", "--json"]) == 0
    assert [case["board"] for case in one_document(capsys)["cases"]] == ["10mm", "20mm"]


def test_bench_prints_its_rows(fakes, capsys):
    assert main(["bench", "solver"]) == 0
    assert capsys.readouterr().out == "20 pairs: 18.8 times\n"
    assert main(["bench", "solver", "--json"]) == 0
    assert one_document(capsys) == {"benchmark": "solver", "seed": 0, "rows": [{"pairs": 20}]}


def test_unknown_scale_is_in_squares(fakes, capsys):
    fakes.rig = make_rig(t=(-3.0, 0.0, 0.1), is_metric=False)
    assert main(CALIBRATE) == 0
    out = capsys.readouterr().out
    assert "squares" in out and " mm" not in out


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--agent", "dqn"], "--agent is 'dqn'; known: drl, drl-increments"),
        (["--targets", "medium"], "--targets is 'medium'; known: soft, hard"),
        (["--layers", "64,x"], "--layers is '64,x'"),
        (["--board", "chessboard:9x6:30mm"], "--data DIR"),
    ],
)
def test_train_says_what_is_wrong_before_any_work(tmp_path, monkeypatch, capsys, arguments, problem):
    monkeypatch.chdir(tmp_path)
    assert main(["train", *arguments]) == 2
    assert problem in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_train_leaves_other_files_alone(tmp_path, monkeypatch, capsys):
    pytest.importorskip("torch", reason="training needs the train extra")
    (tmp_path / "notes.txt").write_text("mine")
    assert main(["train", "--output", str(tmp_path), "--steps", "10"]) == 3
    assert "notes.txt" not in os.listdir(tmp_path.parent) and (tmp_path / "notes.txt").read_text() == "mine"
    assert str(tmp_path) in capsys.readouterr().err


def test_an_earlier_rig_is_a_prior_and_parts_of_it_are_held(fakes, capsys):
    assert main([*CALIBRATE, "--output", "earlier.json"]) == 0
    assert fakes.calls["calibrate"].prior is None
    assert main([*CALIBRATE, "--output", "next.json", "--prior", "earlier.json", "--hold", "left, right.fx"]) == 0
    prior = fakes.calls["calibrate"].prior
    assert "left.fx" in prior.held and "left.k1" in prior.held and "right.fx" in prior.held
    assert "right.fy" in prior.names and "rotation.x" in prior.names and "left.fy" not in prior.names
    assert prior.rig.baseline_m == pytest.approx(fakes.rig.baseline_m)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--hold", "left"], 2, "name the prior with --prior"),
        (["--prior", "earlier.json", "--hold", ""], 2, "nothing is given"),
        (["--prior", "none.json"], 3, "none.json: is missing (no such file)"),
        (["--prior", "earlier.json", "--hold", "nose"], 2, "no 'nose' to hold"),
        (["--prior", "earlier.json", "--model", "fisheye4"], 2, "leave out --model"),
    ],
)
def test_a_prior_that_cannot_be_is_named(arguments, code, words, fakes, capsys):
    assert main([*CALIBRATE, "--output", "earlier.json"]) == 0
    assert main([*CALIBRATE, "--output", "next.json", *arguments]) == code
    assert words in capsys.readouterr().err and not os.path.exists("next.json")


@pytest.mark.parametrize(
    "options",
    [
        ["--output", "rig.yml", "--opencv", "rig.yml"],
        ["--output", "both/extrinsics.yml", "--opencv", "both"],
        ["--output", "rig.json", "--opencv", "new/../rig.yml", "--evidence", "rig.yml"],
    ],
)
def test_two_outputs_are_two_files(fakes, capsys, options):
    assert main([*CALIBRATE, *options]) == 2
    assert "name the same file" in capsys.readouterr().err and "list_pairs" not in fakes.calls


@pytest.mark.parametrize("value", ["inf", "nan", "1e400", "-inf"])
@pytest.mark.parametrize("option", ["--blur", "--noise", "--gap"])
def test_numbers_of_a_simulation_are_finite(fakes, capsys, option, value):
    assert main(["simulate", "--board", "chessboard:11x8:10mm", "--pairs", "2", "--output", "o", option, value]) == 2
    assert capsys.readouterr().err.count("\n") == 1 and os.listdir() == []


@pytest.mark.parametrize("change", ["singular", "infinite"])
def test_a_prior_of_a_singular_covariance_is_the_files_fault(fakes, capsys, change):
    assert main([*CALIBRATE, "--output", "earlier.json"]) == 0
    document = json.loads(Path("earlier.json").read_text())
    matrix = document["covariance"]["matrix"]
    matrix[1] = matrix[0] if change == "singular" else [None] * len(matrix)
    for row in matrix if change == "singular" else ():
        row[1] = row[0]
    Path("earlier.json").write_text(json.dumps(document))
    capsys.readouterr()
    assert main([*CALIBRATE, "--output", "next.json", "--prior", "earlier.json"]) == 3
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("kind", [errors.DataError, errors.DegenerateGeometryError])
def test_what_opencv_cannot_hold_does_not_lose_the_rig(fakes, capsys, monkeypatch, kind):
    from binocal.formats import opencv_yaml

    def refuse(*_, **__):
        raise kind("OpenCV has no such lens.")

    monkeypatch.setattr(opencv_yaml, "opencv_texts", refuse)
    assert main([*CALIBRATE, "--opencv", "rig.yml"]) == 3
    said = capsys.readouterr().err
    assert "no such lens" in said and "wrote rig.json all the same" in said and os.listdir() == ["rig.json"]
