"""One suite over every calibrator in the registry."""

from __future__ import annotations

import pytest

from binocal.calibrators import CALIBRATORS, known_calibrators, load_calibrator
from binocal.calibrators.registry import evidence_of
from contracts import BOARD_CONTRACT, CALIBRATOR_CONTRACT, result_comes_back_from_its_file


@pytest.mark.parametrize("check", CALIBRATOR_CONTRACT, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", CALIBRATORS)
def test_contract(name, check):
    check(name)


@pytest.mark.parametrize("check", BOARD_CONTRACT, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", [name for name in CALIBRATORS if evidence_of(name) == "board"])
def test_contract_of_boards(name, check):
    check(name)


@pytest.mark.parametrize("name", CALIBRATORS)
def test_result_comes_back_from_its_file(name, tmp_path):
    result_comes_back_from_its_file(name, tmp_path)


def test_an_unknown_name_is_answered_with_the_known_ones():
    assert known_calibrators()[: len(CALIBRATORS)] == tuple(CALIBRATORS)
    with pytest.raises(ValueError, match="'magic'; known: drl, drl-increments, lm"):
        load_calibrator("magic")
