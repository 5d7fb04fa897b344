"""The link between a driver and its port: one exchange at a time, in step, within its deadline."""

import pytest

from drivers.errors import PortLost, ReplyGarbled, ReplyTimeout
from drivers.link import LONGEST_LINE, Link, ReplyReader


class Resync:
    """Counts how often a link asked to be brought back into step."""

    def __init__(self) -> None:
        self.times = 0

    def __call__(self) -> None:
        self.times += 1


class Log:
    def __init__(self) -> None:
        self.lines = []

    def record(self, t_s, port, direction, data) -> None:
        self.lines.append((t_s, port, direction, data))


def line(reader: ReplyReader) -> bytes:
    return reader.read_line()


def make(port, clock, **more) -> tuple[Link, Resync]:
    resync = Resync()
    return Link(port, clock=clock, resynchronise=resync, **more), resync


def test_an_exchange_returns_what_receive_made_of_the_reply(scripted, clock) -> None:
    link, resync = make(scripted([(b"a\n", b"1\n"), (b"b\n", b"2\n")]), clock)
    assert link.exchange(b"a\n", line, deadline_s=1.0) == b"1\n"
    assert link.exchange(b"b\n", line, deadline_s=1.0) == b"2\n"
    assert resync.times == 0


def test_a_timeout_brings_the_line_into_step_before_the_next_request(scripted, clock) -> None:
    link, resync = make(scripted([(b"a\n", b""), (b"b\n", b"2\n")]), clock)
    with pytest.raises(ReplyTimeout, match="scripted: no complete reply within 1 s"):
        link.exchange(b"a\n", line, deadline_s=1.0)
    assert resync.times == 0
    assert link.exchange(b"b\n", line, deadline_s=1.0) == b"2\n"
    assert resync.times == 1


def test_a_cut_reply_is_a_timeout_that_shows_what_came(scripted, clock) -> None:
    link, _ = make(scripted([(b"a\n", b"12")]), clock)
    with pytest.raises(ReplyTimeout, match="only b'12' came"):
        link.exchange(b"a\n", line, deadline_s=1.0)


def test_a_late_reply_never_answers_the_next_request(scripted, clock) -> None:
    port = scripted([(b"a\n", b""), (b"b\n", b"2\n")])
    drained = []
    link = Link(port, clock=clock, resynchronise=lambda: drained.append(link.drain()))
    with pytest.raises(ReplyTimeout):
        link.exchange(b"a\n", line, deadline_s=1.0)
    port.ready = b"1\n1"
    assert link.exchange(b"b\n", line, deadline_s=1.0) == b"2\n"
    assert drained == [b"1"]


def test_a_doubled_reply_is_noticed_before_the_next_request(scripted, clock) -> None:
    port = scripted([(b"a\n", b"1\n1\n"), (b"b\n", b"2\n")])
    drained = []
    link = Link(port, clock=clock, resynchronise=lambda: drained.append(link.drain()))
    assert link.exchange(b"a\n", line, deadline_s=1.0) == b"1\n"
    assert link.exchange(b"b\n", line, deadline_s=1.0) == b"2\n"
    assert len(drained) == 1


def test_whatever_ends_an_exchange_early_leaves_the_line_out_of_step(scripted, clock) -> None:
    link, resync = make(scripted([(b"a\n", b"1\n"), (b"b\n", b"2\n")]), clock)

    def interrupted(reader: ReplyReader) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        link.exchange(b"a\n", interrupted, deadline_s=1.0)
    link.exchange(b"b\n", line, deadline_s=1.0)
    assert resync.times == 1


def test_an_urgent_exchange_does_not_wait_for_the_line_and_does_not_heal_it(scripted, clock) -> None:
    link, resync = make(scripted([(b"a\n", b""), (b"stop\n", b"ok\n"), (b"b\n", b"2\n")]), clock)
    with pytest.raises(ReplyTimeout):
        link.exchange(b"a\n", line, deadline_s=1.0)
    link.exchange(b"stop\n", line, deadline_s=1.0, urgent=True)
    assert resync.times == 0
    link.exchange(b"b\n", line, deadline_s=1.0)
    assert resync.times == 1


def test_unsolicited_lines_go_to_their_handler_wherever_they_come(scripted, clock) -> None:
    heard = []

    def alarm(text: bytes) -> bool:
        if text.startswith(b"!"):
            heard.append(text)
        return text.startswith(b"!")

    port = scripted([(b"a\n", b"!1\n1\n"), (b"b\n", b"2\n")])
    link, resync = make(port, clock, unsolicited=alarm)
    assert link.exchange(b"a\n", line, deadline_s=1.0) == b"1\n"
    port.ready = b"!2\n"
    assert link.exchange(b"b\n", line, deadline_s=1.0) == b"2\n"
    assert heard == [b"!1\n", b"!2\n"]
    assert resync.times == 0


def test_a_line_without_end_is_refused(scripted, clock) -> None:
    link, _ = make(scripted([(b"a\n", b"x" * (LONGEST_LINE + 1))]), clock)
    with pytest.raises(ReplyGarbled, match="a line of more than 4096 bytes"):
        link.exchange(b"a\n", line, deadline_s=1.0)


def test_a_device_that_never_falls_silent_ends_the_draining(clock) -> None:
    class Babbler:
        name = "babbler"

        def read(self, timeout_s: float) -> bytes:
            return b"x"

    link, _ = make(Babbler(), clock)
    link.longest_drain_s = 0.01
    with pytest.raises(ReplyGarbled, match="sends without pause"):
        link.drain()


def test_a_count_of_bytes_can_be_received(scripted, clock) -> None:
    link, _ = make(scripted([(b"geti", b"getixyz")]), clock)
    assert link.exchange(b"geti", lambda reader: reader.read_exactly(7), deadline_s=1.0) == b"getixyz"


def test_every_byte_is_logged_with_its_time_and_direction(scripted, clock) -> None:
    log = Log()
    link, _ = make(scripted([(b"a\n", b"1\n")]), clock, wire_log=log)
    clock.sleep(2.5)
    link.exchange(b"a\n", line, deadline_s=1.0)
    assert log.lines == [(2.5, "scripted", ">", b"a\n"), (2.5, "scripted", "<", b"1\n")]


def test_a_lost_port_passes_through(clock) -> None:
    class Gone:
        name = "gone"

        def read(self, timeout_s: float) -> bytes:
            raise PortLost("it is gone.", where="gone")

    link, _ = make(Gone(), clock)
    with pytest.raises(PortLost):
        link.exchange(b"a\n", line, deadline_s=1.0)
