"""Interrupts of work without devices: none is lost, and being ended cleans up as being interrupted does."""

import os
import signal
import sys
import threading
import weakref

import pytest

from bench.terminal.signals import reliable_interrupts


class _Cleared:
    """Something that Python clears away."""


def _cleared_up_with(error):
    """Clear an object away, with an error raised meanwhile, and go on working."""

    def fail(_gone):
        raise error

    gone = _Cleared()
    kept = weakref.ref(gone, fail)
    del gone
    return kept


def test_an_interrupt_that_falls_into_clearing_up_is_raised_again():
    def work():
        kept = _cleared_up_with(KeyboardInterrupt)
        threading.Event().wait(60)
        return kept

    before = sys.unraisablehook
    with pytest.raises(KeyboardInterrupt), reliable_interrupts():
        work()
    assert sys.unraisablehook is before


def test_none_is_lost_in_a_background_job_either():
    """Shells start background jobs with SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:

        def work():
            kept = _cleared_up_with(KeyboardInterrupt)
            threading.Event().wait(60)
            return kept

        with pytest.raises(KeyboardInterrupt), reliable_interrupts():
            work()
    finally:
        signal.signal(signal.SIGINT, before)


def test_being_ended_breaks_off_as_an_interrupt_does():
    def work():
        os.kill(os.getpid(), signal.SIGTERM)
        threading.Event().wait(60)

    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), reliable_interrupts():
        work()
    assert signal.getsignal(signal.SIGTERM) is before


def test_other_errors_in_clearing_up_go_where_they_went(monkeypatch):
    told = []
    monkeypatch.setattr(sys, "unraisablehook", told.append)
    with reliable_interrupts():
        _cleared_up_with(ValueError)
    assert [one.exc_type for one in told] == [ValueError]
