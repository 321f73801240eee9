"""Ends the parts of a server one after the other; one that fails or hangs does not keep the next from its end."""

import asyncio
import logging
from collections.abc import Awaitable, Callable

log = logging.getLogger(__name__)


async def closing(name: str, close: Callable[[], Awaitable[None]], seconds: float) -> None:
    """Await `close()` for at most `seconds`; what goes wrong is logged and not raised."""
    try:
        async with asyncio.timeout(seconds):
            await close()
    except TimeoutError:
        log.error("%s did not end within %g s", name, seconds)  # noqa: TRY400 its traceback says nothing more
    except Exception:
        log.exception("%s did not end well", name)
