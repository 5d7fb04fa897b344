"""The supervisor of this process, which started it and is named by the environment.

A worker that is still starting ends with its supervisor, by a signal of the kernel (PR_SET_PDEATHSIG of prctl(2)).
On other systems the run notices later that its supervisor is gone. A run that has begun is not ended by the signal:
it switches its devices off first.
"""

from __future__ import annotations

import os
import signal
import sys

SUPERVISOR = "STARBENCH_SUPERVISOR"
"""Environment variable: process id of the supervisor of this process."""
_PR_SET_PDEATHSIG = 1  # Of linux/prctl.h


def supervisor() -> int | None:
    """Return the process id of the supervisor, if the environment names one."""
    text = os.environ.get(SUPERVISOR, "")
    return int(text) if text.isdecimal() else None


def end_with_supervisor() -> None:
    """Let this process end when its supervisor ends."""
    if supervisor() == os.getppid():
        _signal_at_end_of_parent(signal.SIGTERM)


def outlive_supervisor() -> None:
    """Let this process go on when its supervisor ends: it looks after its own safe end."""
    if supervisor() is not None:
        _signal_at_end_of_parent(0)


def _signal_at_end_of_parent(number: int) -> None:
    if sys.platform == "linux":
        import ctypes  # only a worker needs it

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, ctypes.c_ulong(number))
