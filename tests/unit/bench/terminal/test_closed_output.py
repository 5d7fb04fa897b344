"""Output whose reader has gone: the work goes on, and its exit status is its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys
from bench.terminal.encoding import outlive_readers, output_is_lost
outlive_readers()
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


def test_the_work_goes_on_after_its_reader_has_gone():
    read, write = os.pipe()
    process = started(write)
    os.close(write)
    os.close(read)
    _, said = process.communicate(b"begin\n")
    assert process.returncode == 7
    assert said == b"error 0\nerror 1\nerror 2\n"


def test_both_outputs_may_lose_their_reader():
    read, write = os.pipe()
    process = started(write, write)
    os.close(write)
    os.close(read)
    process.communicate(b"begin\n")
    assert process.returncode == 7


def test_a_reader_that_stays_gets_all():
    said, errors = (process := started(subprocess.PIPE)).communicate(b"begin\n")
    assert process.returncode == 8
    assert said.splitlines()[-1] == b"a program that this one starts"
    assert errors.count(b"error") == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_full_disk_behind_the_output_is_one_message():
    with Path("/dev/full").open("wb") as full:
        ended = subprocess.run(
            [sys.executable, "-m", "bench", "schema", "queue"],
            stdout=full,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert ended.returncode == 1
    said = ended.stderr.decode()
    assert said.startswith("starbench: standard output: No space left on device. Make room on the disk.")
    assert said.count("\n") == 1
