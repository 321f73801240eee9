"""What every source file owes its reader: an opening line that says what it is for, and no promises."""

import re

from tests.rules.sources import ROOT, files, name

PROMISES = re.compile(r"\b(" + "|".join(["TO" + "DO", "FIX" + "ME", "XX" + "X", "HA" + "CK"]) + r")\b")
SWITCHED_OFF = re.compile(r"^\s*#\s*if\s+0\b|GTEST_SKIP|\bDISABLED_\w|pytest\.mark\.xfail", re.MULTILINE)
FOLDERS = ("core", "client", "server", "proto", "tests")


def test_no_file_promises_instead_of_delivering() -> None:
    sources = [path for folder in FOLDERS for path in files(folder, ".py", ".h", ".cpp", ".proto", ".md")]
    assert [name(path) for path in sources if PROMISES.search(path.read_text())] == []


def test_nothing_is_switched_off() -> None:
    sources = [path for folder in FOLDERS for path in files(folder, ".py", ".h", ".cpp")]
    wrong = [name(path) for path in sources if SWITCHED_OFF.search(path.read_text())]
    assert [found for found in wrong if found != "tests/rules/test_words.py"] == []


def test_a_file_opens_with_one_line_that_says_what_it_is_for() -> None:
    openings = {
        ".py": re.compile(r'(#!.*\n)?r?"""\S'),
        ".h": re.compile(r"// \S"),
        ".cpp": re.compile(r"// \S"),
        ".proto": re.compile(r"// \S"),
    }
    wrong = [
        name(path)
        for folder in FOLDERS
        for suffix, opening in openings.items()
        for path in files(folder, suffix)
        if not opening.match(path.read_text()) and path.stat().st_size > 0
    ]
    wrong += [
        name(path) for path in [ROOT / "CMakeLists.txt", ROOT / "Makefile"] if not path.read_text().startswith("# ")
    ]
    assert wrong == []


def test_a_header_is_included_once() -> None:
    assert [name(path) for path in files("core", ".h") if "#pragma once" not in path.read_text()] == []
