"""The fault line as a process, in front of a device on another port."""

import json
import os
import subprocess
from functools import partial

import serial
from running import answer_of, start_python


def start(port: str, link) -> subprocess.Popen[str]:
    words = ("--port", port, "--baud", 115_200, "--link", link)
    return start_python("-m", "simulators.fault_line", *words, stdin=subprocess.PIPE)


def test_it_passes_everything_on_and_spoils_what_it_is_told_to(zaber_port: str, tmp_path):
    process = start(zaber_port, tmp_path / "spoilt")
    link = json.loads(process.stdout.readline())["link"]
    say = partial(answer_of, process)
    with serial.Serial(link, 115_200, timeout=2.0) as line:

        def ask(request: bytes) -> bytes:
            line.write(request)
            return line.read_until(b"\n")

        good = ask(b"/1 0 07 get system.serial\n")
        assert good.startswith(b"@01 0 07 OK IDLE WR 100101")
        assert say("replaced pattern=100101 replacement=999999")["ok"]
        assert ask(b"/1 0 07 get system.serial\n") == good.replace(b"100101", b"999999")
        assert ask(b"/1 0 07 get system.serial\n") == good
        assert not say("stall")["ok"]
        assert say("unplug")["ok"]
        assert not os.path.lexists(link)
    _, errors = process.communicate(timeout=30)
    assert (process.returncode, errors) == (0, "")


def test_a_device_that_is_not_there_ends_it_in_one_line(tmp_path):
    process = start(str(tmp_path / "nothing"), tmp_path / "spoilt")
    output, errors = process.communicate(timeout=30)
    assert (process.returncode, output) == (2, "")
    assert "Cannot open the port" in errors
    assert errors.count("\n") == 1
