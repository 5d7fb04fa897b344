"""The n-th call of libc that changes a file below a folder fails, or kills the process, as `failing_disk.c` lets it.

As SQLite is tested: a work is repeated, and each time the next of its calls fails, until all calls pass. Each try is a fork
of a process that has loaded everything and done the work once.
"""

import ctypes
import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

from bench.base.errors import BenchError

KILLED = 0
MODES = (errno.ENOSPC, errno.EIO, KILLED)
TRACEBACK_STATUS = 3
_SOURCE = Path(__file__).with_name("failing_disk.c")


def try_in_process(program, folder, steps):
    """Let calls of works fail, in a process of a program that has the library; return how many did, and its end."""
    if sys.platform != "linux" or shutil.which("cc") is None:
        pytest.skip("needs Linux and a C compiler")
    library = folder / "failing_disk.so"
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", library, _SOURCE, "-ldl"], check=True)
    here = os.pathsep.join([str(_SOURCE.parent), *sys.path])
    ended = subprocess.run(
        [sys.executable, program, folder, json.dumps(steps)],
        env={**os.environ, "LD_PRELOAD": str(library), "PYTHONPATH": here},
        capture_output=True,
        text=True,
        check=False,
    )
    counts = re.findall(r"(\d+) calls failed or killed", ended.stdout)
    return sum(map(int, counts)), ended


def assert_each_call_may_fail(program, folder, name):
    """Let each call of a work fail, one after the other; a step spares some of them."""
    step = int(os.environ.get("FAILING_CALLS_STEP", "1"))
    count, ended = try_in_process(program, folder, {name: (1, step)})
    assert (ended.returncode, count * step >= 20) == (0, True), ended.stdout + ended.stderr


@dataclass(frozen=True)
class Tried:
    """The end of a try: its exit status, negative for a signal; what it said; the call that failed; calls in all."""

    status: int
    said: str
    failed: str
    calls: int


def tried(work, folder, call=0, mode=errno.EIO):
    """Do a work in a fork, in which one call below the folder fails; none if ``call`` is 0."""
    libc = ctypes.CDLL(None)
    libc.failed_call.restype = ctypes.c_char_p
    with tempfile.TemporaryFile() as said:
        sys.stdout.flush()
        child = os.fork()
        if child == 0:
            status = TRACEBACK_STATUS
            try:
                os.dup2(said.fileno(), 1)
                os.dup2(said.fileno(), 2)
                libc.fail_call(os.fsencode(folder), call, mode)
                status = _status_of(work)
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(status)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        said.seek(0)
        return Tried(status, said.read().decode(), libc.failed_call().decode(), libc.counted_calls())


def _status_of(work):
    try:
        work()
    except SystemExit as end:
        return int(end.code or 0)
    except BenchError as error:
        print(f"starbench: {error}")
        return 1
    except BaseException:  # noqa: BLE001 - the fork must not go on as its parent
        traceback.print_exc()
        return TRACEBACK_STATUS
    return 0


def each_call(work, folder, *, first=1, step=1):
    """Let each call of a work fail in each mode; return the kinds of calls that failed, and what then fell."""
    kinds, fallen = Counter(), []
    for mode in MODES:
        call = first
        while True:
            prepared = work.prepare(folder)
            end = tried(lambda state=prepared: work.do(state), folder, call, mode)
            if not end.failed:
                break
            kinds[kind_of(end.failed, folder)] += 1
            what = f"{work.name}, call {call} {os.strerror(mode) if mode else 'kills'}, {end.failed}"
            fault = fault_of(end, folder, mode)
            try:
                work.check(prepared, end)
            except Exception as error:  # noqa: BLE001 - whatever comes of a failing disk is told
                fault = f"{fault} then {error!r}"
            if fault:
                fallen.append(f"{what}: {fault}"[:1500])
            remove(folder)
            call += step
        remove(folder)
    return kinds, fallen


def fault_of(end, folder, mode):
    """What is wrong with the end itself: it crashed, was no sentence, or named no path; empty if nothing."""
    if mode == KILLED:
        return "" if end.status == -signal.SIGKILL else f"it was not killed: {end.said}"
    if end.status < 0 or "Traceback" in end.said or "defect" in end.said:
        return f"status {end.status}: {end.said}"
    return "" if end.status == 0 or str(folder) in end.said else f"no path: {end.said}"


def kind_of(failed, folder):
    """The kind of a failed call: what was called, and the file's name without its numbers."""
    name, _, place = failed.partition(" ")
    inside = place.removeprefix(f"{folder}/").split("/")[-2:]
    return f"{name} {re.sub('[0-9a-f]{6,}|[0-9]+', 'N', '/'.join(inside))}"


def remove(folder):
    """Remove a folder, with what is read-only in it."""
    for path in (folder, *folder.rglob("*")):
        if path.is_dir() and not path.is_symlink():
            path.chmod(0o755)
    shutil.rmtree(folder)
