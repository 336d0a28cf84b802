"""The kept list of mutants fits the source; ``make mutants`` runs it."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import run


def test_every_mutant_of_the_list_still_stands_in_the_source():
    mutants = run.load_mutants()
    assert len(mutants) >= 60
    assert not run.list_problems(mutants)
