"""Requirements as sentences: what they say, and what makes no sense."""

import pytest

from binocal.requirements import parse_requirement


@pytest.mark.parametrize(
    ("text", "quantity", "limit", "is_relative", "range_m", "unit"),
    [
        ("depth 1% at 5m", "depth", 0.01, True, 5.0, "%"),
        ("depth 0.5 % at 50 cm", "depth", 0.005, True, 0.5, "%"),
        ("depth 5mm at 1m", "depth", 0.005, False, 1.0, "m"),
        ("row 0.1px", "row", 0.1, False, None, "px"),
        ("row .1 px at 2m", "row", 0.1, False, 2.0, "px"),
        ("baseline 0.02%", "baseline", 2e-4, True, None, "%"),
        ("baseline 0.1mm", "baseline", 1e-4, False, None, "m"),
        ("focal 0.05%", "focal", 5e-4, True, None, "%"),
        ("focal 1px", "focal", 1.0, False, None, "px"),
        ("reprojection 3e-1px", "reprojection", 0.3, False, None, "px"),
    ],
)
def test_what_a_sentence_says(text, quantity, limit, is_relative, range_m, unit):
    need = parse_requirement(text)
    assert need.quantity == quantity and need.limit == pytest.approx(limit) and need.is_relative is is_relative
    assert need.range_m == (None if range_m is None else pytest.approx(range_m)) and need.unit == unit


def test_matching_and_board_pitches():
    assert parse_requirement("depth 1% at 5m with 0.25px").matching_px == 0.25
    pitches = parse_requirement("depth 1% at 50")
    assert pitches.is_metric is False and pitches.range_m == 50
    assert parse_requirement("row 0.1px").is_metric is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("depth 1% at 5 px", "'5 px' is no range"),
        ("depth 1%", "depth depends on the range"),
        ("depth 1px at 5m", "limited in % or a length, not in px"),
        ("row 0.1%", "limited in px, not in %"),
        ("row 0.1mm", "limited in px, not in mm"),
        ("banana 3%", "nothing is known of 'banana'"),
        ("baseline 0.02", "not without a unit"),
        ("baseline 3apples", "no unit of length"),
        ("focal 0%", "above 0"),
        ("focal 1e999%", "a limit is finite"),
        ("depth 5m at 1m", "were the two exchanged?"),
        ("depth 500% at 1m", "asks for nothing"),
        ("depth -1% at 5m", "is no requirement"),
        ("reprojection 0.3px at 5m", "leave out 'at 5m'"),
        ("depth 5mm at 100", "both lengths a unit"),
        ("depth 1% at 5m with 3mm", "'with' says how well depth is matched"),
        ("row 0.1px with 0.2px", "'with' says how well depth is matched"),
        ("", "is no requirement"),
        ("x" * 500, "…"),
    ],
)
def test_what_makes_no_sense_is_said(text, said):
    with pytest.raises(ValueError) as error:
        parse_requirement(text)
    assert said in str(error.value) and "\n" not in str(error.value) and len(str(error.value)) < 300
