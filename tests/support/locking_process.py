"""Another process that has locked a folder, as that of a run or a batch has; it can be suspended."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager

_LOCK = """
import fcntl, os, sys
fcntl.flock(os.open(sys.argv[1], os.O_RDONLY), fcntl.LOCK_EX)
print("locked", flush=True)
sys.stdin.read()
"""


@contextmanager
def locking(folder):
    """Yield a process that has locked a folder until the end of the block."""
    words = [sys.executable, "-c", _LOCK, str(folder)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        try:
            process.stdout.readline()
            yield process
        finally:
            process.kill()


def suspend(process):
    """Suspend a process, as Ctrl-Z does, and wait until it is."""
    process.send_signal(signal.SIGSTOP)
    os.waitpid(process.pid, os.WUNTRACED)
