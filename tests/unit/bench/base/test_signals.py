"""Signals and interrupts at any moment, and output whose reader has gone."""

import os
import signal
import subprocess
import sys
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from running import python

from bench.base.clock import Aborted, BenchClock, Interrupted, reliable_interrupts, stop_on_signals

MANY_SIGNALS = """
import os
import signal
from bench.base.clock import Aborted, BenchClock, Interrupted
stopped = 0
for number in range(400):
    clock = BenchClock()
    signal.signal(signal.SIGALRM, lambda *_: clock.request_stop("stop"))
    signal.setitimer(signal.ITIMER_REAL, 0.0002 + number % 40 * 1e-5)
    try:
        while True:
            clock.interrupt("door")
            try:
                clock.sleep(0.0)
            except Interrupted:
                clock.clear_interruption()
            clock.sleep(1e-6)
    except Aborted:
        stopped += 1
print(stopped)
"""


def test_a_signal_at_any_moment_of_a_wait_stops_it():
    assert python("-c", MANY_SIGNALS).stdout == "400\n"


CUT_OFF = """
import time
from bench.base.clock import BenchClock
BenchClock().in_parallel(lambda: (time.sleep(0.3), print("computed")))
print("ends")
"""


def test_a_program_ends_after_the_work_that_its_clock_began():
    assert python("-c", CUT_OFF).stdout == "ends\ncomputed\n"


def test_the_third_ctrl_c_ends_the_process_at_once():
    reasons, pressed_s = [], iter([5.0, 6.5])
    with stop_on_signals(reasons.append, monotonic=lambda: next(pressed_s)):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert reasons == ["stopped by Ctrl-C", "SIGTERM received"]


def test_a_key_that_is_held_is_one_press():
    """A keyboard repeats it after half a second, then thirty times a second."""
    reasons, pressed_s = [], iter([5.0, *(5.5 + 0.033 * n for n in range(60))])
    with stop_on_signals(reasons.append, monotonic=lambda: next(pressed_s)):
        for _ in range(61):
            signal.raise_signal(signal.SIGINT)
    assert reasons == ["stopped by Ctrl-C"]


def test_a_hang_up_that_nohup_ignores_stops_nothing():
    reasons, before = [], signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stop_on_signals(reasons.append):
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert reasons == []


def test_all_who_wait_are_woken_and_what_was_taken_back_wakes_nobody():
    clock = BenchClock()
    clock.interrupt("door")
    clock.clear_interruption()
    clock.sleep(0.01)
    clock.interrupt("door")
    with pytest.raises(Interrupted):
        clock.sleep(60)
    clock.clear_interruption()
    with ThreadPoolExecutor(3) as pool:
        waiting = [pool.submit(clock.sleep, 60) for _ in range(3)]
        clock.request_stop("all of you")
        assert [type(wait.exception(10)) for wait in waiting] == [Aborted] * 3


# ---------------------------------------------------------------- work without devices


class _Cleared:
    """Something that Python clears away."""


def _cleared_up_with(error):
    """Delete an object whose finaliser raises an error, and go on working."""

    def fail(_gone):
        raise error

    gone = _Cleared()
    kept = weakref.ref(gone, fail)
    del gone
    return kept


@pytest.mark.parametrize("handler", [signal.default_int_handler, signal.SIG_IGN])
def test_an_interrupt_that_falls_into_clearing_up_is_raised_again_in_a_background_job_too(handler):
    """Shells start background jobs with SIGINT ignored."""

    def work():
        kept = _cleared_up_with(KeyboardInterrupt)
        threading.Event().wait(60)
        return kept

    before, hook = signal.signal(signal.SIGINT, handler), sys.unraisablehook
    try:
        with pytest.raises(KeyboardInterrupt), reliable_interrupts():
            work()
    finally:
        signal.signal(signal.SIGINT, before)
    assert sys.unraisablehook is hook


ENDED = """
import signal
from bench.commands import cli
cli.cli.main = lambda **_: signal.raise_signal(signal.SIGTERM)
cli.main([])
"""


def test_every_command_that_is_ended_clears_up_as_after_an_interrupt():
    assert python("-c", ENDED, status=130).stderr == "Stopped.\n"


def test_other_errors_in_clearing_up_go_where_they_went(monkeypatch):
    unraisable = []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    with reliable_interrupts():
        _cleared_up_with(ValueError)
    assert [error.exc_type for error in unraisable] == [ValueError]


# ---------------------------------------------------------------- output whose reader has gone

PROGRAM = """
import sys
from bench.base.lost_output import output_is_lost, protect_output
protect_output()
print(sys.stdin.readline(), flush=True)
for number in range(3):
    print("line", number, flush=True)
    print("error", number, file=sys.stderr, flush=True)
import subprocess
subprocess.run(["echo", "a program that this one starts"], check=True)
sys.exit(7 if output_is_lost() else 8)
"""


def started(stdout: int, stderr: int = subprocess.PIPE) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM], stdin=subprocess.PIPE, stdout=stdout, stderr=stderr
    )


@pytest.mark.parametrize("both", [False, True])
def test_the_work_goes_on_after_the_readers_of_its_output_have_gone(both):
    read, write = os.pipe()
    process = started(write, write if both else subprocess.PIPE)
    os.close(write)
    os.close(read)
    _, errors = process.communicate(b"begin\n")
    assert process.returncode == 7
    assert errors == (None if both else b"error 0\nerror 1\nerror 2\n")


STOPPED = """
import sys
from bench.base.clock import BenchClock, stop_on_signals
from bench.base.lost_output import protect_output
protect_output()
with stop_on_signals(BenchClock().request_stop):
    for number in range(3000):
        print("state", number, "." * 60, file=sys.stderr, flush=True)
print("ends", flush=True)
"""


@pytest.mark.parametrize("opened", [os.pipe, os.openpty])
def test_the_work_does_not_wait_for_a_reader_of_its_errors_that_has_stopped(opened):
    """Ctrl-S, a pager, a stalled connection."""
    read, write = opened()
    process = subprocess.Popen([sys.executable, "-c", STOPPED], stdout=subprocess.PIPE, stderr=write)
    assert process.communicate(timeout=60)[0] == b"ends\n"
    assert os.read(read, 100).startswith(b"state 0 ...")
    os.close(read)
    os.close(write)


CLOSED = """
import os, subprocess, sys
from bench.base.lost_output import protect_output
protect_output()
print("line", flush=True)
print("error", file=sys.stderr, flush=True)
file = os.open(sys.argv[1], os.O_WRONLY | os.O_CREAT)
assert sys.stdin.read() == "", "something to read"
subprocess.run([sys.executable, "-c", "import os; [os.fstat(n) for n in range(3)]"], check=True)
sys.exit(file)
"""


@pytest.mark.parametrize("closed", ["2>&-", ">&-", "<&-", "<&- >&- 2>&-"])
def test_a_stream_that_was_closed_before_the_start_takes_no_file_and_ends_no_work(tmp_path, closed):
    words = ["sh", "-c", f'exec "$0" -c "$1" "$2" {closed}', sys.executable, CLOSED, str(tmp_path / "file")]
    ended = subprocess.run(words, check=False, stdin=subprocess.DEVNULL, capture_output=True)
    assert ended.returncode > 2, ended.stderr
    assert (tmp_path / "file").read_bytes() == b""


def test_a_reader_that_stays_gets_all():
    output, errors = (process := started(subprocess.PIPE)).communicate(b"begin\n")
    assert process.returncode == 8
    assert output.splitlines()[-1] == b"a program that this one starts"
    assert errors.count(b"error") == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_full_disk_behind_the_output_is_one_message():
    with Path("/dev/full").open("wb") as full:
        command = [sys.executable, "-m", "bench", "schema", "queue"]
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False)
    assert ended.returncode == 1
    errors = ended.stderr.decode()
    assert errors.startswith("starbench: standard output: ")
    assert errors.count("\n") == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_full_disk_behind_the_errors_ends_no_work():
    with Path("/dev/full").open("wb") as full:
        process = started(subprocess.PIPE, full.fileno())
        process.communicate(b"begin\n")
    assert process.returncode == 8
