"""A worker that is still starting ends with its supervisor; one whose run has begun ends itself."""

import os
import select
import signal
import subprocess
import sys

import pytest

_WORKER = """
import sys, time
from bench.base.supervised import end_with_supervisor, outlive_supervisor
end_with_supervisor()
if sys.argv[1] == "begun":
    outlive_supervisor()
print("ready", flush=True)
time.sleep(600)
"""
_SUPERVISOR = """
import os, subprocess, sys, time
environ = {**os.environ, "STARBENCH_SUPERVISOR": str(os.getpid())}
worker = subprocess.Popen([sys.executable, "-c", sys.argv[1], sys.argv[2]], env=environ, stdout=subprocess.PIPE)
worker.stdout.readline()
print(worker.pid, flush=True)
time.sleep(600)
"""


def end_of_worker(work: str, patience_s: float) -> bool:
    """Kill the supervisor of a worker, and return whether the worker ends within this time."""
    command = [sys.executable, "-c", _SUPERVISOR, _WORKER, work]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as boss:
        assert boss.stdout is not None
        pid = int(boss.stdout.readline())
        worker = os.pidfd_open(pid)
        boss.kill()
        ended, _, _ = select.select([worker], [], [], patience_s)
        if not ended:
            signal.pidfd_send_signal(worker, signal.SIGKILL)
        os.close(worker)
    return bool(ended)


@pytest.mark.skipif(sys.platform != "linux", reason="a signal of the Linux kernel")
def test_a_worker_that_is_starting_ends_with_its_supervisor():
    assert end_of_worker("starting", patience_s=60.0)


@pytest.mark.skipif(sys.platform != "linux", reason="a signal of the Linux kernel")
def test_a_worker_whose_run_has_begun_goes_on_to_its_own_safe_end():
    assert not end_of_worker("begun", patience_s=1.0)
