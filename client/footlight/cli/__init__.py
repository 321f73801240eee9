"""The command line: `footlight render`, `explain`, `serve`."""

from footlight.cli.app import main as main

__all__ = ["main"]
