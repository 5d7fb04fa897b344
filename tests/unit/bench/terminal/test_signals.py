"""Signals at any moment, and the clock that they ask to stop."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from bench.base.clock import Aborted, BenchClock, Interrupted
from bench.terminal.signals import stop_on_signals

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
    said = subprocess.run(
        [sys.executable, "-c", MANY_SIGNALS], capture_output=True, text=True, timeout=120, check=False
    )
    assert said.stdout == "400\n", said.stderr


def test_the_first_signal_ends_a_long_wait():
    clock = BenchClock()
    timer = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM))
    with stop_on_signals(clock.request_stop):
        timer.start()
        with pytest.raises(Aborted, match="SIGTERM received"):
            clock.sleep(60)
        timer.join()


def test_the_third_ctrl_c_ends_the_process_at_once():
    reasons = []
    with stop_on_signals(reasons.append):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert reasons == ["SIGINT received", "SIGTERM received"]


def test_all_who_wait_are_woken_and_what_was_taken_back_wakes_nobody():
    clock = BenchClock()
    clock.interrupt("door")
    clock.clear_interruption()
    clock.sleep(0.01)
    clock.interrupt("door")
    with pytest.raises(Interrupted):
        clock.sleep(60)
    clock.clear_interruption()
    ended = []

    def wait():
        try:
            clock.sleep(60)
        except Aborted:
            ended.append(1)

    waiting = [threading.Thread(target=wait) for _ in range(3)]
    for thread in waiting:
        thread.start()
    clock.request_stop("all of you")
    for thread in waiting:
        thread.join(10)
    assert len(ended) == 3
