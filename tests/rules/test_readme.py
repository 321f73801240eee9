"""The paths and make targets that READMEs name exist."""

import re
from pathlib import Path

import pytest

from tests.rules.sources import ROOT, SKIPPED_FOLDERS, name

READMES = sorted(path for path in ROOT.rglob("README.md") if not SKIPPED_FOLDERS & set(path.relative_to(ROOT).parts))
ENDINGS = "py|h|cpp|proto|md|toml|txt|usda|lock|in|yaml|png"
PATH = re.compile(rf"^(\.\./)*[\w.-]+(/[\w.-]+)*(/|\.({ENDINGS}))$")
MADE = ("build/", ".venv/")


def named_paths(readme: Path) -> list[str]:
    """What stands in backquotes and reads as a path, and what links point to."""
    text = re.sub(r"```.*?```", "", readme.read_text(), flags=re.DOTALL)
    quoted = [word for word in re.findall(r"`([^`\s]+)`", text) if PATH.match(word)]
    linked = [link for link in re.findall(r"\]\(([^)#\s]+)\)", text) if "://" not in link]
    return [path for path in quoted + linked if not path.startswith(MADE)]


@pytest.mark.parametrize("readme", READMES, ids=name)
def test_named_paths_exist(readme: Path) -> None:
    missing = [path for path in named_paths(readme) if not ((readme.parent / path).exists() or (ROOT / path).exists())]
    assert missing == []


@pytest.mark.parametrize("readme", READMES, ids=name)
def test_named_make_targets_exist(readme: Path) -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"`make ([a-z-]+)`", readme.read_text())) <= targets
