"""``--require`` and the comparison with the rig, from the command line: verdicts, exit codes, plans, and what makes no sense."""

import json
from dataclasses import replace

import numpy as np
import pytest

from binocal import app
from binocal.app import evaluate as evaluating
from binocal.app.corners import FoundCorners
from binocal.app.needs import NeedReport
from binocal.boards import parse_board
from binocal.calibrators import calibrate
from binocal.cli import main
from binocal.cli.needs import needs_text
from binocal.formats import rig_json
from binocal.geometry import SE3, so3
from binocal.planning import PlannedView, ViewPlan
from binocal.requirements import Figure, Outcome, Verdict, parse_requirement
from binocal.simulation import StereoScene, sample_board_poses, simulate_detections, table2_rig

RIG, SPEC = table2_rig(), "chessboard:6x5:30mm"
BOARD = parse_board(SPEC)
EVALUATE = ["--left", "l", "--right", "r", "--board", SPEC]
CALIBRATE = ["calibrate", "--left", "l/*.png", "--right", "r/*.png", "--board", SPEC]


def seen(n_views, seed):
    rng = np.random.default_rng(seed)
    return simulate_detections(StereoScene(RIG, BOARD, sample_board_poses(RIG, BOARD, n_views, rng)), rng, noise_px=0.1)


@pytest.fixture(scope="module")
def calibration():
    return calibrate(seen(12, 0), model="brown4", calibrator="lm")


@pytest.fixture
def images(monkeypatch):
    """Other images than those of the calibration: their corners."""
    found = FoundCorners(seen(8, 1), (), (), (), {})
    monkeypatch.setattr(evaluating, "find_corners", lambda *given, **options: found)


def written(tmp_path, calibration):
    path = tmp_path / "rig.json"
    rig_json.write_calibration(path, calibration)
    return str(path)


def document_of(capsys):
    return json.loads(capsys.readouterr().out, parse_constant=lambda word: pytest.fail(word))


def test_new_images_are_judged(tmp_path, calibration, images, capsys):
    path = written(tmp_path, calibration)
    assert main(["evaluate", path, *EVALUATE, "--require", "row 0.5px", "--require", "depth 10% at 1m", "--json"]) == 0
    document = document_of(capsys)
    assert [v["outcome"] for v in document["requirements"]] == ["pass", "pass"] and document["plans"] == []
    assert document["agreement"]["agrees"] and document["agreement"]["p_value"] > 1e-4 and document["findings"] == []
    assert main(["evaluate", path, *EVALUATE, "--require", "baseline 0.0001%", "--require", "reprojection 0.01px"]) == 4
    text = capsys.readouterr().out
    assert text.startswith("FAIL     baseline 0.0001%: not met") and "Plan     20 more views do not meet" in text
    assert "Agreement: the images agree" in text


def test_an_undecided_need_and_a_plan_of_one_view_read_as_sentences():
    need = parse_requirement("row 0.1px")
    verdict = Verdict(need, Figure(0.1, 0.02, "the row error"), Outcome.UNDECIDED)
    view = PlannedView(SE3.identity(), (320.0, 240.0), 0.5, 30.0, "top", 0.05)
    plans = tuple(ViewPlan(need, 0.1, (view,), is_enough, "nothing more helps") for is_enough in (True, False))
    first, *rest = needs_text(NeedReport((verdict,), plans), ("mm", 1e3))
    assert first.startswith("Undecided row 0.1px: undecided")
    text = "\n".join(rest)
    assert "1 more view meets row 0.1px" in text and "1 more view does not meet row 0.1px" in text


def test_a_pitched_rig_is_not_passed_in_silence(tmp_path, calibration, images, capsys):
    W, T = so3.exp(np.radians([0.05, 0, 0])), calibration.rig.T_right_left
    pitched = replace(calibration, evidence=None, rig=replace(calibration.rig, T_right_left=SE3(W @ T.R, W @ T.t)))
    path = written(tmp_path, pitched)
    assert main(["evaluate", path, *EVALUATE]) == 4
    text = capsys.readouterr().out
    assert text.startswith("warning: left and right corners miss each other under this rig by") and "pitch" in text
    assert (
        main(["evaluate", path, *EVALUATE, "--require", "row 0.1px", "--require", "depth 0.0001% at 1m", "--json"]) == 4
    )
    document = document_of(capsys)
    row, depth = document["requirements"]
    assert row["outcome"] == "fail" and row["value"] > 1.0 and "left image" in row["where"]
    assert depth["outcome"] == "fail" and document["plans"] == []  # what has changed is no matter of more views
    assert document["agreement"]["cause"]["code"].endswith("turned")
    assert document["findings"][0]["code"] == "rig-does-not-fit"


def test_a_rig_without_standard_deviations_is_undecided(tmp_path, calibration, images, capsys):
    path = tmp_path / "bare.json"
    rig_json.write_rig(path, calibration.rig)
    assert main(["evaluate", str(path), *EVALUATE, "--json"]) == 0
    document = document_of(capsys)
    assert document["agreement"] is None and document["common_rows"]["common_px"] < 0.1 and document["findings"] == []
    assert main(["evaluate", str(path), *EVALUATE, "--require", "depth 1% at 1m", "--require", "row 0.5px"]) == 4
    text = capsys.readouterr().out
    assert "states no standard deviations" in text and "Pass     row 0.5px" in text
    assert "Agreement: only by rows, without the rig's standard deviations: off by 0.0" in text


def test_rows_tell_of_a_turn_where_the_rig_states_no_standard_deviations(
    tmp_path, calibration, images, monkeypatch, capsys
):
    T = calibration.rig.T_right_left
    turned = replace(calibration.rig, T_right_left=SE3(so3.exp(np.radians([0.05, 0, 0])) @ T.R, T.t))
    path = tmp_path / "bare.json"
    rig_json.write_rig(path, turned)
    assert main(["evaluate", str(path), *EVALUATE, "--json"]) == 4
    (found,) = document_of(capsys)["findings"]
    assert found["code"] == "rows-off" and found["figures"]["common_px"] == pytest.approx(1.4, abs=0.1)
    monkeypatch.setattr(evaluating, "find_corners", lambda *given, **o: FoundCorners(seen(3, 1), (), (), (), {}))
    assert main(["evaluate", str(path), *EVALUATE]) == 0
    assert "Agreement: cannot be judged: the rig states no standard deviations" in capsys.readouterr().out


def test_a_rig_that_was_changed_by_hand_is_named_though_its_residuals_fit(tmp_path, calibration, images, capsys):
    made = replace(calibration, provenance={**calibration.provenance, "board": SPEC})
    T, left = made.rig.T_right_left, made.T_left_board
    rng = np.random.default_rng(0)
    own = (T @ left).R, (T @ left).t + rng.normal(0, 1e-4, left.t.shape)
    own = SE3(own[0] @ so3.exp(rng.normal(0, 1e-4, left.t.shape)), own[1])
    apart = replace(made, evidence=None, T_left_board=left, T_right_board=own, board_shape=None)
    assert evaluating._changed_by_hand(replace(made, T_right_board=None)) is None  # taken together
    shifted = replace(apart, rig=replace(apart.rig, T_right_left=SE3(T.R, T.t + [0, 0, 2e-3])))
    found = evaluating._changed_by_hand(shifted)
    assert found.code == "rig-file-changed" and found.figures["standard_errors"] > 10
    assert evaluating._changed_by_hand(replace(shifted, provenance={"board": "a wall"})) is None
    assert main(["evaluate", written(tmp_path, shifted), *EVALUATE, "--json"]) == 4
    assert "rig-file-changed" in [one["code"] for one in document_of(capsys)["findings"]]


def test_the_truth_judges_exactly(tmp_path, calibration, capsys):
    truth = tmp_path / "truth.json"
    names = tuple(view.name for view in calibration.views)
    rig_json.write_truth(truth, rig_json.Truth(RIG, BOARD, names, calibration.T_left_board))
    path = written(tmp_path, calibration)
    command = ["evaluate", path, "--truth", str(truth), "--json", "--require"]
    assert main([*command, "depth 10% at 1m"]) == 0
    (verdict,) = document_of(capsys)["requirements"]
    assert verdict["guard"] == 0 and 0 < verdict["value"] < 0.1
    assert main([*command, "baseline 0.0000001%"]) == 4


@pytest.mark.parametrize(
    ("need", "said"),
    [
        ("depth 1% at 5 px", "'5 px' is no range"),
        ("depth 1% at 50", "in board pitches"),
        ("nonsense", "is no requirement"),
    ],
)
def test_a_need_that_makes_no_sense_is_a_usage_error_of_one_line(need, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([*CALIBRATE, "--require", need]) == 2
    out, err = capsys.readouterr()
    assert not out and said in err and len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_calibrate_judges_and_plans(tmp_path, calibration, monkeypatch, capsys):
    run = app.CalibrationRun(calibration, seen(12, 0), (), (), {"images": 1.0, "solve": 0.1})
    monkeypatch.setattr(app, "calibrate_images", lambda *given, **options: run)
    monkeypatch.chdir(tmp_path)
    assert main([*CALIBRATE, "--require", "depth 50% at 1m", "--json"]) == 0
    assert document_of(capsys)["requirements"][0]["outcome"] == "pass"
    assert main([*CALIBRATE, "--force", "--require", "depth 0.1% at 1m", "--json"]) == 4
    document = document_of(capsys)
    (plan,) = document["plans"]
    assert plan["views"] and plan["views"][0]["value"] > plan["views"][-1]["value"]
    assert np.array(plan["views"][0]["R"]).shape == (3, 3) and document["requirements"][0]["where"]
    assert (tmp_path / "rig.json").is_file()  # what was calibrated is kept
    assert main([*CALIBRATE, "--force", "--require", "reprojection 0.001px"]) == 4
    assert "FAIL     reprojection" in capsys.readouterr().out
