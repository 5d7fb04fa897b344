"""Work for the workers of a cluster that dies, fails or needs memory; workers import it by its name."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from bench.base.errors import UsageError


def double(number):
    return 2 * number


def die_once(marker, value):
    """Kill the own process, unless an earlier call has done so."""
    path = Path(marker)
    if not path.exists():
        path.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    return value


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def refuse():
    raise UsageError("No such thing.", where="here", remedy="Do nothing.")


def defect():
    return {}["missing"]


def take_memory(size):
    return float(np.ones(size // 8).sum())


def rest(seconds, place=""):
    """Do nothing; note the number of the process in a file, or return it."""
    if place:
        Path(place).write_text(str(os.getpid()))
    time.sleep(seconds)
    return os.getpid()
