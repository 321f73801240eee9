"""The list of wrong renderers does not rot: what each changes stands once in the core, and its tests exist."""

import subprocess
import sys

import pytest

from tests.mutants.mutants import MUTANTS, Mutant
from tests.rules.sources import ROOT


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_mutants_text_occurs_once(mutant: Mutant) -> None:
    source = (ROOT / "core" / mutant.file).read_text()
    assert mutant.applied_to(source) != source


def test_text_that_is_gone_is_an_error() -> None:
    with pytest.raises(ValueError, match="occurs 0 times"):
        MUTANTS[0].applied_to("")
    with pytest.raises(ValueError, match="occurs 2 times"):
        MUTANTS[0].applied_to(2 * MUTANTS[0].text)


def test_mutants_have_names_of_their_own_and_tests() -> None:
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS)
    assert all(mutant.tests for mutant in MUTANTS)


def test_the_tests_that_reject_mutants_exist() -> None:
    tests = sorted({test for mutant in MUTANTS for test in mutant.tests})
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider", *tests]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120)
    assert result.returncode == 0, result.stdout + result.stderr
    assert set(tests) <= set(result.stdout.splitlines()), "a node id without its parameters"
