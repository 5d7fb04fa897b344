"""The n-th call to the disk fails: a run, its seal, a certificate, the ledger and the keys end in words and go on."""

import os
import shutil
import sys
from datetime import timedelta
from unittest import mock

import pytest
from authorising import make_key, person
from certificate_lab import FIRST, Lab, quick_files
from certificate_sample import NOW
from failing_calls import FailingCalls, Tally, each_call
from virtual_bench import VirtualBench

from bench.base.errors import BenchError, UsageError
from bench.evidence.authorisation import authorise
from bench.evidence.key_rotation import rotate
from bench.evidence.key_trust import read_trust
from bench.evidence.keys import load_key
from bench.evidence.signers import SIGNERS_FILE, read_signers, trust
from bench.evidence.states import standing_of
from bench.evidence.verify import verify_folder
from bench.extras.certificate import issue as issue_module
from bench.extras.certificate.series import numbers
from bench.record.storage import sha256_of

SAMPLE = 29
"""Every so many calls of the longer works are tried here; the whole loop is slow."""


def run_with(bench, calls):
    """Run. What failed is told with a path."""
    try:
        with calls:
            end = bench.begin()
    except BenchError as error:
        why, unsafe = str(error), []
    else:
        why, unsafe = end.why, list(end.unsafe)
    assert (not why or str(bench.folder) in why, unsafe) == (True, []), why


def see_that_it_goes_on(bench, calls, usual):
    """Run with a failing call, then do what an operator does next; nothing is lost, and nothing looks changed."""
    run_with(bench, calls)
    stored = bench.stored()
    bench.finish()
    assert bench.stored()[: len(stored)] == stored
    assert bench.faults() == usual
    assert bench.breaks() == []
    with_lost_log = any("wire_log_ended_s" in entry.data for entry in bench.entries())
    # The log writes without a sync. The seal opens, syncs and closes it to writing; that is done again.
    of_log = calls.failed.endswith("wire.jsonl")
    assert with_lost_log <= of_log
    assert with_lost_log or not (of_log and calls.failed.startswith("write"))


def a_run_goes_on(tmp_path, first, step):
    """Let calls of a run fail; return how many did by kind, and what then fell."""
    undisturbed, count, tally = VirtualBench(tmp_path / "undisturbed"), 0, Tally()
    undisturbed.begin()
    usual = undisturbed.faults()
    assert {fault.kind for fault in usual} <= {"results", "journal"}, usual

    def work(passing, number):
        nonlocal count
        count += 1
        bench = VirtualBench(tmp_path / f"bench-{count}")
        calls = FailingCalls(bench.folder, passing, number)
        try:
            see_that_it_goes_on(bench, calls, usual)
        except Exception as error:  # noqa: BLE001 - whatever comes of a failing disk is told
            tally.fallen.append(f"{passing} {os.strerror(number)}, {calls.failed}: {error!r}"[:1500])
        shutil.rmtree(bench.folder)
        return calls

    for calls in each_call(work, first=first, step=step):
        tally.add(calls)
    tally.show("run")
    return tally


def test_a_run_of_which_one_call_to_the_disk_fails_ends_in_words_and_is_finished(tmp_path):
    tally = a_run_goes_on(tmp_path, first=3, step=SAMPLE)
    assert (tally.fallen, len(tally) >= 6) == ([], True)


@pytest.mark.slow
@pytest.mark.timeout(3 * 3600)
def test_whichever_call_of_a_run_fails_it_ends_in_words_and_is_finished(tmp_path):
    step = int(os.environ.get("FAILING_CALLS_STEP", "1"))
    assert a_run_goes_on(tmp_path, first=0, step=step).fallen == []


EACH = pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.slow)], ids=["some", "all"])


def each_goes_on(tmp_path, step, prepare, do, check):
    """Let each call of a work fail once, then see what is left of it; return how many failed, and what then fell."""
    tally = Tally()

    def work(passing, number):
        folder = tmp_path / "here"
        prepared = prepare(folder)
        calls, done = FailingCalls(folder, passing, number), True
        try:
            with calls:
                do(prepared)
        except Exception as error:  # noqa: BLE001 - whatever comes of a failing disk is told
            done = False
            if not (isinstance(error, BenchError) and str(folder) in str(error)):
                tally.fallen.append(
                    f"{passing} {os.strerror(number)}, {calls.failed}: it said {error!r}"[:700]
                )
        try:
            check(prepared, done=done)
        except Exception as error:  # noqa: BLE001 - whatever comes of a failing disk is told
            tally.fallen.append(f"{passing} {os.strerror(number)}, {calls.failed}: {error!r}"[:700])
        shutil.rmtree(folder)
        return calls

    for calls in each_call(work, step=step):
        tally.add(calls)
    tally.show(do.__name__)
    return tally


@EACH
def test_whichever_call_of_an_issue_fails_the_same_command_ends_it_with_the_same_number(tmp_path, step):
    def issued(lab, *, done):
        if not done and lab.numbers() == {FIRST: "issued"}:  # the line is there, its sync had failed
            with pytest.raises(UsageError, match=f"This folder is the certificate {FIRST}, which is issued"):
                lab.issue()
        elif not done:
            lab.issue()
        assert lab.numbers() == {FIRST: "issued"}
        (certificate,) = numbers(lab.ledger.entries()).values()
        assert certificate.seal == sha256_of(lab.path / "certificate" / "SHA256SUMS")
        assert lab.ledger.breaks() == ([], [])

    with (
        mock.patch.object(issue_module, "certificate_files", quick_files),
        mock.patch("bench.extras.certificate.pdf.plots_of_run", return_value={}),
    ):
        tally = each_goes_on(tmp_path, step, Lab, Lab.issue, issued)
    assert (tally.fallen, step * len(tally) > 60) == ([], True)


def see_that_the_seal_holds(lab):
    """The sample is no whole run, which the verifier tells; its files are those that were sealed, by a trusted key."""
    kinds = {fault.kind for fault in verify_folder(lab.run, read_trust(lab.home)).faults}
    assert kinds <= {"form", "journal", "results"}


class Authorised:
    """A sealed run, and a person who may authorise it."""

    def __init__(self, folder):
        self.lab = Lab(folder)
        self.key, signer = person(make_key(folder))
        trust(self.lab.home, signer.line)

    def authorise(self):
        authorise(self.lab.run, self.key, read_trust(self.lab.home), NOW)

    def state(self):
        return standing_of(self.lab.run, read_trust(self.lab.home), NOW).state.value


@EACH
def test_whichever_call_of_an_authorisation_fails_it_is_whole_or_not_there(tmp_path, step):
    def authorised(prepared, *, done):
        if not done and prepared.state() != "AUTHORISED":
            prepared.authorise()
        assert prepared.state() == "AUTHORISED"
        see_that_the_seal_holds(prepared.lab)

    tally = each_goes_on(tmp_path, step, Authorised, Authorised.authorise, authorised)
    assert (tally.fallen, step * len(tally) > 8) == ([], True)


class Entered:
    """The ledger of a bench with a run."""

    def __init__(self, folder):
        self.lab = Lab(folder)

    def enter(self):
        ledger, folder = self.lab.ledger, self.lab.run
        place = ledger.begin(run_id="next", folder=folder, camera="1", simulated=True)
        ledger.end(place["number"], how="finished", folder=folder)
        ledger.append("noted", what="something")


@EACH
def test_whichever_call_of_the_ledger_fails_no_line_is_lost_and_no_break_is_seen(tmp_path, step):
    def whole(prepared, *, done):
        before = [run.number for run in prepared.lab.ledger.runs()]
        prepared.enter()
        after = [run.number for run in prepared.lab.ledger.runs()]
        assert after == list(range(1, len(before) + 2))
        assert done <= (len(before) == 2)
        assert prepared.lab.ledger.breaks() == ([], [])

    tally = each_goes_on(tmp_path, step, Entered, Entered.enter, whole)
    assert (tally.fallen, step * len(tally) > 30) == ([], True)


@EACH
def test_whichever_call_of_a_change_of_keys_fails_the_bench_has_one_key_that_is_trusted(tmp_path, step):
    def usable(lab, *, done):
        own = load_key(lab.home)
        assert own.public_key in {signer.public_key for signer in read_signers(lab.home / SIGNERS_FILE)}
        see_that_the_seal_holds(lab)
        if not done:
            rotate(lab.home, NOW + timedelta(hours=1), passphrase=None, keep_old=True)
            assert load_key(lab.home).public_key != own.public_key

    def change(lab):
        rotate(lab.home, NOW, passphrase=None, keep_old=True)

    tally = each_goes_on(tmp_path, step, Lab, change, usable)
    assert (tally.fallen, step * len(tally) > 30) == ([], True)


if __name__ == "__main__":
    sys.exit(pytest.main([__file__, "-s", "-n", "0", "-m", "slow", *sys.argv[1:]]))
