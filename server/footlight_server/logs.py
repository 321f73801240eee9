"""The log on stderr: as text for people or as JSON for machines, and never with a token in it."""

import logging

from footlight_server.farm.tokens import PREFIX, SECRET


class TextFormatter(logging.Formatter):
    """One line per record, and its traceback."""

    def format(self, record: logging.LogRecord) -> str:
        """The text without secrets."""
        return without_secrets(super().format(record))


def configure(log_format: str, level: int) -> None:
    """Log to stderr from now on: `text` or `json`; of what is not ours, warnings only."""
    handler = logging.StreamHandler()
    handler.setFormatter(json_formatter() if log_format == "json" else text_formatter())
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.getLogger("footlight_server").setLevel(level)


def text_formatter() -> logging.Formatter:
    """`2026-01-31 12:00:00,000 INFO footlight_server: message`."""
    return TextFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s")


def json_formatter() -> logging.Formatter:
    """One object per line: `time` (ISO 8601, UTC), `level`, `logger`, `message`, what `extra` gave, `exc_info`."""
    from pythonjsonlogger.json import JsonFormatter  # noqa: PLC0415 only whoever asks for JSON pays for it

    class SecretlessFormatter(JsonFormatter):
        def format(self, record: logging.LogRecord) -> str:
            return without_secrets(super().format(record))

    return SecretlessFormatter(
        "%(levelname)s %(name)s %(message)s", rename_fields={"levelname": "level", "name": "logger"}, timestamp="time"
    )


def without_secrets(text: str) -> str:
    """The text with every token in it made useless. Nothing logs one on purpose; a traceback might."""
    return SECRET.sub(f"{PREFIX}…", text)
