"""A broken stream goes on where it was, patiently and not for ever; one that never began fails at once."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterator

import pytest

from footlight.errors import DeniedError, FootlightError, NotReadingError, ServerUnavailableError
from footlight.resume import LONGEST_PAUSE, Patience, resumed, resumed_async


class Clock:
    """[s] Moves only when it is told."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def gone() -> ServerUnavailableError:
    return ServerUnavailableError("gone")


def test_a_stream_that_never_began_is_not_tried_again() -> None:
    with pytest.raises(ServerUnavailableError):
        Patience(100).after(gone())


def test_pauses_grow_and_end_and_begin_anew_after_a_message() -> None:
    clock, told = Clock(), list[FootlightError]()
    patience = Patience(30, told.append, clock)
    for _ in range(2):
        patience.heard()
        clock.now += 1e6  # however long it was well
        began, pauses = clock.now, list[float]()
        with contextlib.suppress(ServerUnavailableError):
            while clock.now < began + 1000:
                pauses.append(patience.after(gone()))
                clock.now += pauses[-1]
        assert pauses[0] == 0.1
        assert pauses == sorted(pauses)
        assert max(pauses) == LONGEST_PAUSE
        assert 30 <= clock.now - began < 30 + LONGEST_PAUSE
    assert len(told) == 2  # once for each break


def test_only_what_may_pass_is_waited_for() -> None:
    patience = Patience(30)
    patience.heard()
    with pytest.raises(DeniedError):
        patience.after(DeniedError("no"))
    assert patience.after(NotReadingError("slow")) == 0.0
    with pytest.raises(NotReadingError):  # cut off again before the first message
        patience.after(NotReadingError("slow"))


class Stream:
    """Numbers from `at`; breaks before each multiple of three, once."""

    def __init__(self, at: int, broken: set[int]) -> None:
        self.at, self.broken, self.cancelled = at, broken, 0

    def numbers(self) -> Iterator[int]:
        while self.at < 10:
            if self.at % 3 == 0 and self.at not in self.broken and self.at > 0:
                self.broken.add(self.at)
                raise gone()
            self.at += 1
            yield self.at - 1

    def __iter__(self) -> Iterator[int]:
        return self.numbers()

    async def __aiter__(self) -> AsyncIterator[int]:
        for number in self.numbers():
            yield number

    def cancel(self) -> None:
        self.cancelled += 1


def opener(seen: list[int], streams: list[Stream]) -> Callable[[], Stream]:
    broken = set[int]()

    def call() -> Stream:
        streams.append(Stream(seen[-1] + 1 if seen else 0, broken))
        return streams[-1]

    return call


def test_every_message_comes_once_and_every_stream_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("footlight.resume.FIRST_PAUSE", 0.001)
    seen, streams = list[int](), list[Stream]()
    for number in resumed("here", Patience(5), opener(seen, streams)):
        seen.append(number)
    assert seen == list(range(10))
    assert [stream.cancelled for stream in streams] == [1, 1, 1, 1]


async def test_the_same_with_asyncio(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("footlight.resume.FIRST_PAUSE", 0.001)
    seen, streams = list[int](), list[Stream]()
    async with asyncio.timeout(10):
        async for number in resumed_async("here", Patience(5), opener(seen, streams)):
            seen.append(number)
    assert seen == list(range(10))
    assert [stream.cancelled for stream in streams] == [1, 1, 1, 1]


def test_an_error_of_the_consumer_is_not_mistaken_for_one_of_the_stream() -> None:
    streams = list[Stream]()

    def consume() -> None:
        for _ in resumed("here", Patience(5), opener([], streams)):
            raise ServerUnavailableError("mine")

    with pytest.raises(ServerUnavailableError, match="mine"):
        consume()
    assert [stream.cancelled for stream in streams] == [1]
