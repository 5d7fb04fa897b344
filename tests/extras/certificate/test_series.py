"""The series of certificate numbers: without gaps, each given once, whatever process dies and whenever."""

import threading
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest

from bench.base.errors import EvidenceError, JournalBroken
from bench.extras.certificate.series import (
    ISSUED,
    RESERVED,
    Wanted,
    declare_void,
    enter_issued,
    numbers,
    one_at_a_time,
    reserve,
)
from bench.record.ledger import Ledger
from bench.record.ledger_marks import LEDGER_BROKEN

NOW = datetime(2026, 11, 21, 8, 30, tzinfo=UTC)


class Bench:
    """A ledger whose clock is set by hand."""

    def __init__(self, home):
        self.now = NOW
        self.ledger = Ledger(home, SimpleNamespace(utc_now=lambda: self.now, monotonic=lambda: 0.0))

    def reserve(self, run="a", **facts):
        words = {"number_format": "SB-{year}-{number:05d}", "simulated": False, "run_seal": run * 64}
        facts = {**words, "run_id": run, "folder": f"/c/{run}", **facts}
        return reserve(self.ledger, Wanted(**facts), self.now)

    def issue(self, run="a", **facts):
        number = self.reserve(run, **facts).number
        enter_issued(self.ledger, number, seal="5" * 64, serial="00050423", customer="Customer")
        return number

    def numbers(self):
        return numbers(self.ledger.entries())


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path / "home")


def test_simulated_certificates_and_each_year_have_a_series_of_their_own(bench):
    assert bench.issue("a") == "SB-2026-00001"
    assert bench.issue("b", simulated=True) == "SIMULATED-SB-2026-00001"
    bench.now = NOW.replace(year=2027)
    assert bench.issue("c") == "SB-2027-00001"
    assert bench.issue("d", number_format="N{number}") == "N1"


def test_numbers_go_on_behind_those_that_only_a_second_place_knows(bench):
    bench.issue("a")
    (series,) = {certificate.series for certificate in bench.numbers().values()}
    known = [{"place": "a disk elsewhere", "head": "0" * 64, "runs": 0, "counts": {series: 7}}]
    facts = {"what": ["lines are missing"], "kept": None, "reason": "lost", "by": "ada"}
    bench.ledger.append(LEDGER_BROKEN, known=known, **facts)
    assert bench.issue("b") == "SB-2026-00008"
    assert len(bench.numbers()) == 8


def test_a_number_left_open_goes_to_the_next_certificate_of_the_same_run_also_in_a_new_year(bench):
    left = bench.reserve("a").number
    assert bench.reserve("a", folder="/elsewhere").number == left
    assert bench.numbers()[left].folder == "/elsewhere"
    with pytest.raises(EvidenceError, match=r"with the same numbers\.format"):
        bench.reserve("a", number_format="X-{number}")
    bench.now = NOW.replace(year=2027)
    assert bench.issue("a") == left == "SB-2026-00001"
    assert bench.issue("b") == "SB-2027-00001"


def test_a_second_certificate_of_a_run_needs_a_reason_and_a_first_one(bench):
    with pytest.raises(EvidenceError, match="--reason"):
        bench.reserve("a", also="x")
    first = bench.issue("a")
    with pytest.raises(EvidenceError, match=f"{first} of 2026-11-21.*amend.*issue .* --reason"):
        bench.reserve("a")
    assert bench.issue("a", also="a copy") == "SB-2026-00002"


def test_a_number_left_open_stops_other_runs_until_it_is_void(bench):
    left = bench.reserve("a").number
    with pytest.raises(EvidenceError, match=f"{left} .*certificate void {left}"):
        bench.reserve("b")
    declare_void(bench.ledger, left, reason="the disk broke", by="Ada")
    issued = bench.issue("b")
    assert issued == "SB-2026-00002"
    assert (bench.numbers()[left].how, bench.numbers()[left].reason) == ("void", "the disk broke")
    for number, why in ((issued, "is issued already"), ("SB-2026-00099", "is not in the ledger")):
        with pytest.raises(EvidenceError, match=why):
            declare_void(bench.ledger, number, reason="x", by="Ada")


def test_only_the_newest_certificate_can_be_amended(bench):
    first = bench.issue("a")
    second = bench.issue("a", amends=first)
    assert bench.numbers()[first].superseded_by == second
    for facts, why in (
        ({"amends": first}, f"{first} cannot be amended: {second} replaced it. Amend {second}"),
        ({"amends": "SB-2020-00001"}, "it is not in the ledger of this bench"),
        ({}, f"has a certificate already: {second}"),
    ):
        with pytest.raises(EvidenceError, match=why):
            bench.reserve("a", **facts)
    left = bench.reserve("a", amends=second).number
    with pytest.raises(EvidenceError, match=f"{left} .*certificate void {left}"):
        bench.reserve("a", also="a copy")
    assert bench.issue("a", amends=second) == left == "SB-2026-00003"


def test_a_clock_that_was_set_back_is_noticed(bench):
    bench.issue("a")
    bench.now = NOW - timedelta(hours=1)
    with pytest.raises(EvidenceError, match=r"2026-11-21 07:30:00 UTC, .*08:30:00"):
        bench.reserve("b")
    bench.now = NOW - timedelta(seconds=1)
    bench.reserve("b")


@pytest.mark.parametrize(
    "lines",
    [
        [(RESERVED, {"number": "SB-2", "series": "SB-{number}", "count": 2, "run_seal": "", "run_id": ""})],
        [(ISSUED, {"number": "SB-1", "seal": "", "serial": "", "customer": ""})],
        [(RESERVED, {"number": "SB-1"})],
        [(RESERVED, {"number": "SB-1", "series": "SB-{number}", "count": "one"})],
    ],
    ids=["gap", "issued but never reserved", "incomplete", "no count"],
)
def test_a_gap_in_the_numbers_is_noticed(bench, lines):
    for event, facts in lines:
        bench.ledger.append(event, **facts)
    with pytest.raises(JournalBroken, match="number is missing"):
        bench.numbers()


def test_numbers_lost_with_lines_of_the_ledger_are_not_given_again(bench):
    bench.issue("a")
    bench.issue("b")
    whole = bench.ledger.path.read_bytes().splitlines(keepends=True)
    bench.ledger.path.write_bytes(b"".join(whole[:2]))
    with pytest.raises(EvidenceError, match="ledger --explain"):
        bench.reserve("c")
    bench.ledger.explain("restored from the backup of yesterday", "Ada")
    assert bench.issue("c") == "SB-2026-00003"
    assert [certificate.how for certificate in bench.numbers().values()] == ["issued", "lost", "issued"]


def test_two_processes_take_turns(bench):
    order = []

    def other():
        with one_at_a_time(bench.ledger.home):
            order.append("other")

    with one_at_a_time(bench.ledger.home):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join(0.1)
        order.append("first")
    thread.join()
    assert order == ["first", "other"]
