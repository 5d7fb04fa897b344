"""The simulated bench as a process: its ports, its truth file, its end, and one world behind all devices."""

import json
import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
import serial
from running import answer_of, start_python
from waiting import wait_until

from simulators.bench import Bench, main
from simulators.config import bench_config
from simulators.faults.catalogue import fault_order_from_text


def start(folder, *words: str, until_eof: bool = True) -> subprocess.Popen[str]:
    words += ("--until-eof",) * until_eof
    return start_python("-m", "simulators.bench", "--folder", folder, *words, stdin=subprocess.PIPE)


def ask(line: serial.Serial, request: str) -> str:
    line.write(f"{request}\n".encode())
    return line.read_until(b"\n").decode().strip()


def test_one_line_gives_all_addresses_and_the_end_of_input_ends_the_bench(tmp_path):
    config = tmp_path / "config.json"
    config.write_text(json.dumps({"collimator": {"r": 700.0}, "light": {"serial": "SG7"}}))
    process = start(tmp_path / "ports", "--config", str(config), "--seed", "5")
    addresses = json.loads(process.stdout.readline())
    assert addresses["pid"] == process.pid
    truth = json.loads(Path(addresses["truth"]).read_text(encoding="utf-8"))
    assert truth["collimator"]["r"] == 700.0
    assert truth["camera"]["fx"] == 3345.06
    with serial.Serial(addresses["endpoints"]["gimbal"], 115_200, timeout=5.0) as line:
        assert "100102" in ask(line, "/2 0 00 get system.serial")
    with serial.Serial(addresses["endpoints"]["light"], 9600, timeout=5.0) as line:
        assert ",SG7," in ask(line, "*IDN?")
    host, _, port = addresses["endpoints"]["camera"].partition(":")
    assert host == "127.0.0.1"
    assert int(port) > 0
    _, errors = process.communicate(timeout=30)
    assert (process.returncode, errors) == (0, "")
    assert not os.path.lexists(addresses["endpoints"]["gimbal"])
    assert not os.path.lexists(addresses["endpoints"]["light"])


@pytest.mark.parametrize(
    ("kind", "left_behind", "asked", "answer"),
    [
        ("flir_ptu", ["CV"], b"C ", b"C * PTU is in pure velocity speed control mode\r\n"),
        ("thorlabs_apt", ["10 02 01 02 50 01"], bytes.fromhex("110201005001"), bytes.fromhex("120201020150")),
    ],
)
def test_a_stage_is_found_as_another_program_has_left_it(tmp_path, kind, left_behind, asked, answer) -> None:
    config = bench_config({"stage": {"kind": kind, "left_behind": left_behind}})
    with Bench(tmp_path, config) as bench:
        (address, *_) = (bench.endpoints[name] for name in bench.endpoints if name.startswith("gimbal"))
        baudrate = 9600 if kind == "flir_ptu" else 115_200
        with serial.Serial(address, baudrate, timeout=5.0) as line:
            line.write(asked)
            assert line.read(len(answer)) == answer


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_bench_and_removes_its_ports(tmp_path, number):
    process = start(tmp_path, until_eof=False)
    addresses = json.loads(process.stdout.readline())
    process.send_signal(number)
    _, errors = process.communicate(timeout=30)
    assert (process.returncode, errors) == (0, "")
    assert not os.path.lexists(addresses["endpoints"]["gimbal"])


def test_the_bench_runs_in_the_background_of_a_terminal(tmp_path):
    master, slave = os.openpty()
    # A session's leader that opens a terminal has it as its own: a shell with job control, as an operator types into.
    script = (
        f"exec 0<>{os.ttyname(slave)} 1>&0 2>&0; set -m; "
        f"{sys.executable} -m simulators.bench --folder {tmp_path} > {tmp_path}/said & "
        f"while [ ! -s {tmp_path}/said ]; do sleep 0.1; done; sleep 0.3; jobs; kill %1; wait"
    )
    subprocess.run(["/bin/bash", "-c", script], start_new_session=True, check=False, timeout=60)
    output = os.read(master, 65_536)
    os.close(slave)
    os.close(master)
    assert b"Running" in output
    assert b"Stopped" not in output


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ('{"stage": {"pan": {"serial": 5}}}', "stage.pan.serial: Text is expected, not 5."),
        ("{", "The file is not JSON"),
    ],
)
def test_an_invalid_configuration_ends_in_one_line(tmp_path, capsys, monkeypatch, config, message):
    monkeypatch.setattr(signal, "signal", lambda _number, _handler: None)
    path = tmp_path / "config.json"
    path.write_text(config)
    assert main(["--folder", str(tmp_path), "--config", str(path)]) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert message in errors
    assert errors.count("\n") == 1


def test_faults_are_ordered_while_it_runs_and_each_order_is_answered(tmp_path):
    process = start(tmp_path, "--seed", "3")
    endpoints = json.loads(process.stdout.readline())["endpoints"]
    say = partial(answer_of, process)
    with serial.Serial(endpoints["gimbal"], 115_200, timeout=2.0) as line:
        assert say("gimbal doubled")["ok"]
        assert ask(line, "/1 0 00") == line.read_until(b"\n").decode().strip()
        assert say('{"device": "gimbal", "fault": "lost", "after_s": 0.0, "count": 0}')["ok"]
        assert ask(line, "/1 0 00") == ""
        assert say("gimbal unplug")["ok"]
        assert not os.path.lexists(endpoints["gimbal"])
    assert say("gimbal replug")["ok"]
    assert os.path.lexists(endpoints["gimbal"])
    refused = say("roll stall")
    assert not refused["ok"]
    assert "'roll'" in refused["error"]
    assert not say("{")["ok"]
    assert not say("gimbal replaced pattern=(")["ok"]
    assert not say("light dim factor=-1")["ok"]
    shifted = say("mount shift x_mm=3 y_mm=-1")
    assert (shifted["device"], shifted["fault"], shifted["x_mm"]) == ("mount", "shift", 3.0)
    assert shifted["now"]["shift_mm"] == [3.0, -1.0]
    _, errors = process.communicate(timeout=30)
    assert (process.returncode, errors) == (0, "")


def test_faults_of_the_configuration_happen(tmp_path):
    faults = [
        {"device": "gimbal", "fault": "lost"},
        {"device": "light", "fault": "lamp_open", "after_s": 0.2},
    ]
    with Bench(tmp_path, bench_config({"faults": faults})) as bench:
        with serial.Serial(bench.endpoints["gimbal"], 115_200, timeout=0.3) as line:
            assert ask(line, "/1 0 00") == ""
            assert ask(line, "/1 0 01").startswith("@01 0 01 OK")
        with serial.Serial(bench.endpoints["light"], 9600, timeout=5.0) as line:
            line.write(b"FUNC SQU;:VOLT:HIGH 2;:OUTP ON\n")
            assert ask(line, "OUTP?") == "1"
        wait_until(lambda: bench.world.light(bench.world.now_s()).high == 0.0, 10.0)


def test_without_pseudo_terminals_the_lines_run_over_tcp(tmp_path):
    with Bench(tmp_path, bench_config({"ports": "tcp"})) as bench:
        address = bench.endpoints["gimbal"]
        assert address.startswith("socket://127.0.0.1:")
        for _ in range(2):
            with serial.serial_for_url(address, timeout=5.0) as line:
                assert ask(line, "/2 0 00 get system.serial").startswith("@02 0 00 OK IDLE WR 100102")
        bench.inject(fault_order_from_text("gimbal unplug"))
        with pytest.raises(serial.SerialException):
            serial.serial_for_url(address, timeout=5.0)
        bench.inject(fault_order_from_text("gimbal replug"))
        with serial.serial_for_url(address, timeout=5.0) as line:
            assert ask(line, "/1 0 00").startswith("@01 0 00 OK")
