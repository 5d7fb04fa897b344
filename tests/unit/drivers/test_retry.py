"""The two loops of every protocol: a request repeated after a bad reply, a line brought back into step."""

from collections.abc import Callable
from types import SimpleNamespace

import pytest

from drivers.errors import ReplyGarbled, ReplyTimeout
from drivers.link import RESYNCHRONISE_TRIES, TRIES, repeat
from tests.unit.drivers.conftest import CountedLink


class Line(CountedLink):
    """A line whose old bytes are given, one drain after the other; keeps what happens to it."""

    def __init__(self, *old: bytes) -> None:
        super().__init__(SimpleNamespace(name="port"), None)
        self.old = list(old)
        self.events: list[str] = []

    def drain(self) -> bytes:
        self.events.append("drain")
        return self.old.pop(0) if self.old else b""


def answers(line: Line, *outcomes: bool | Exception) -> Callable[[], bool]:
    """Return a marker's exchange with these outcomes, one after the other."""
    left = list(outcomes)

    def exchange_marker() -> bool:
        line.events.append("marker")
        outcome = left.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    return exchange_marker


def bring_into_step(line: Line, *outcomes: bool | Exception, **more) -> None:
    line.prove_in_step(answers(line, *outcomes), **more)


def test_the_error_of_the_last_attempt_is_passed_on() -> None:
    errors = [ReplyTimeout(str(number)) for number in range(TRIES)]
    left = list(errors)
    pauses: list[int] = []

    def attempt() -> None:
        raise left.pop(0)

    with pytest.raises(ReplyTimeout) as caught:
        repeat(attempt, before_next=lambda: pauses.append(1))
    assert caught.value is errors[-1]
    assert len(pauses) == TRIES - 1


@pytest.mark.parametrize(
    ("old", "answers", "silence_after", "events"),
    [
        pytest.param((), (True,), True, ["drain", "marker", "drain"], id="silent"),
        pytest.param((), (True,), False, ["drain", "marker"], id="silent, with message ids"),
        pytest.param(
            (b"old", b"doubled", b"", b""),
            (True, True),
            True,
            ["drain", "marker", "drain"] * 2,
            id="what follows the marker is a reason to try again",
        ),
    ],
)
def test_a_marker_answered_on_a_silent_line_proves_that_it_is_in_step(old, answers, silence_after, events):
    line = Line(*old)
    bring_into_step(line, *answers, silence_after=silence_after)
    assert line.events == events


@pytest.mark.parametrize("outcome", [False, True], ids=["another answer", "more than was asked for"])
def test_a_line_that_cannot_be_brought_into_step_is_said_to_be_out_of_it(outcome) -> None:
    line = Line(*[b"", b"" if not outcome else b"more"] * RESYNCHRONISE_TRIES)
    with pytest.raises(ReplyGarbled, match="more bytes"):
        bring_into_step(line, *[outcome] * RESYNCHRONISE_TRIES)


def test_a_marker_without_answer_is_sent_again_and_then_an_error() -> None:
    line = Line()
    with pytest.raises(ReplyTimeout, match="second"):
        bring_into_step(line, ReplyTimeout("first"), ReplyTimeout("second"))
    assert line.events == ["drain", "marker"] * 2


@pytest.mark.parametrize(
    ("first", "markers"),
    [(ReplyTimeout("late"), 1), (ReplyTimeout("late", late_s=2.0), 2), (ReplyGarbled("cut"), 2)],
)
def test_a_silent_line_is_not_asked_twice_where_the_caller_repeats(first, markers) -> None:
    line = Line()
    with pytest.raises(ReplyTimeout):
        bring_into_step(line, first, ReplyTimeout("again"), once_if_silent=True)
    assert line.events.count("marker") == markers


def test_old_bytes_are_inspected_before_the_device_is_cleared() -> None:
    line = Line(b"ALARM:1\r\n")
    bring_into_step(
        line,
        True,
        inspect_old=lambda old: line.events.append(old.decode().strip()),
        clear_device=lambda: line.events.append("clear"),
    )
    assert line.events == ["drain", "ALARM:1", "clear", "marker", "drain"]
