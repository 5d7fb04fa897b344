"""A computer without pseudo-terminals, flock and terminal settings, as Windows is: the same runs, over TCP.

Python is made to look so in every process: the modules cannot be imported, ``msvcrt`` locks by POSIX record locks,
select takes sockets alone, a rename replaces nothing, no folder can be opened nor a file synced that is only read, and there are no signals or flags but those that Windows has.
"""

import json
import os
import subprocess
import textwrap
from pathlib import Path

import pytest
from quick_runs import quick_words
from running import (
    PATIENCE_S,
    STARBENCH,
    environment,
    journal,
    killed_at_end,
    python,
    results,
    start_python,
    wait_for,
)

BARE = """
import fcntl, os, select, signal, stat, subprocess, sys, types
import serial, serial.serialposix  # what of pyserial stands for serialwin32 here
for name in ("fcntl", "termios", "tty", "pty"):
    sys.modules[name] = None
for name in ("openpty", "O_DIRECTORY", "O_CLOEXEC", "O_NONBLOCK", "fchmod", "getuid", "geteuid", "pidfd_open", "mkfifo"):
    delattr(os, name)
rename = os.rename
def over_nothing(source, target, **more):
    if os.path.lexists(target) and os.path.isfile(target):
        raise FileExistsError(17, "Cannot create a file when that file already exists", source, None, target)
    rename(source, target, **more)
os.rename = over_nothing
synced, opened, mode_of, reading = os.fsync, os.open, fcntl.fcntl, fcntl.F_GETFL
def sync_what_is_written(descriptor):
    if not mode_of(descriptor, reading) & (os.O_WRONLY | os.O_RDWR):
        raise OSError(9, "Bad file descriptor")
    synced(descriptor)
def open_no_folder(path, flags, mode=0o777, **more):
    if "dir_fd" not in more and os.path.isdir(path):
        raise PermissionError(13, "Permission denied", path)
    return opened(path, flags, mode, **more)
os.fsync, os.open = sync_what_is_written, open_no_folder
msvcrt = types.ModuleType("msvcrt")
msvcrt.LK_NBLCK = 2
msvcrt.locking = lambda descriptor, mode, count: os.lockf(descriptor, os.F_TLOCK, count)
sys.modules["msvcrt"] = msvcrt
for name in ("SIGHUP", "SIGKILL", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGPIPE", "SIGCONT", "pidfd_send_signal", "pthread_sigmask"):
    delattr(signal, name)
take = select.select
def sockets_alone(*waited):
    lists = waited[:3]
    if not any(lists):
        raise OSError(10022, "An invalid argument was supplied")
    for one in (one for some in lists for one in some):
        if not stat.S_ISSOCK(os.fstat(one if isinstance(one, int) else one.fileno()).st_mode) and serial_port(one) is None:
            raise OSError(10038, "An operation was attempted on something that is not a socket")
    return take(*waited)
def serial_port(one):
    # What of pyserial stands for serialwin32 here waits by select: for ports, and the pipes that break a wait off.
    caller = sys._getframe(2).f_globals["__name__"]
    return caller if caller.startswith("serial.") else None
select.select = sockets_alone
"""
LOCK = """
import sys
from drivers import file_lock
held = open(sys.argv[1], "r+b")
file_lock.lock(held.fileno())
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def bare(tmp_path: Path) -> dict[str, str]:
    """Environment in which every Python begins as such a computer's would."""
    folder = tmp_path / "bare"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(textwrap.dedent(BARE))
    path = os.pathsep.join([str(folder), str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    return {**environment(tmp_path / "home"), "PYTHONPATH": path}


def test_a_file_is_locked_once_and_freed_by_the_death_of_its_process(bare, tmp_path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"")
    with killed_at_end(start_python("-c", LOCK, path, stdin=subprocess.PIPE, **bare)) as holder:
        assert holder.stdout.readline() == "held\n"
        assert "BlockingIOError" in python("-c", LOCK, path, status=1, **bare).stderr
    assert python("-c", LOCK, path, **bare).stdout == "held\n"


@pytest.mark.slow
def test_a_run_goes_over_tcp_from_a_station_that_says_nothing_of_it(bare, tmp_path) -> None:
    folder = tmp_path / "run"
    words = ("run", "three_pose", "-s", "simulated", "--seed", 7, "-o", folder, "--json")
    ended = python(*STARBENCH[1:], *words, **bare)
    assert json.loads(ended.stdout)["converged"]
    wire = (folder / "wire.jsonl").read_text()
    assert "socket://127.0.0.1:" in wire
    assert "move abs" in wire
    assert max(abs(row["error_sigmas"]) for row in results(folder)["comparison"]) < 4
    assert [line["accepted"] for line in journal(folder) if line["event"] == "attempt_checked"] == [True] * 3


@pytest.mark.slow  # tests/unit/bench/base/test_progress_and_prompt.py answers without a run
def test_a_question_is_answered_at_a_terminal_that_select_does_not_take(bare, tmp_path) -> None:
    import pty

    folder = tmp_path / "run"
    question = '  - prompt: {text: "Is the cap off?", default: continue, timeout_s: 500}\n'
    words = quick_words(tmp_path, "[{name: left, pan_deg: -6}]", first=question, end="")
    ours, theirs = pty.openpty()
    station = tmp_path / "station.yaml"
    station.write_text(station.read_text().replace("ports: pty, ", ""))
    process = start_python(*STARBENCH[1:], *words, stdin=theirs, **bare)
    try:
        wait_for(process, folder, lambda line: line["event"] == "asked")
        os.write(ours, b"a\n")
        assert "operator" in process.communicate(timeout=PATIENCE_S)[1]
        assert process.returncode == 3
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        os.close(theirs)
