"""Keys of the align command in a terminal: what each does, and that a stop waits for nothing."""

import os
import sys
import time

import pytest
from align_fakes import fake_session, wait_until

from bench.align import serve
from bench.align.terminal_keys import TerminalKeys, keys_of_terminal

RIGHT, UP = b"\x1b[C", b"\x1b[A"


@pytest.fixture
def opened():
    session, devices = fake_session()
    session.open()
    ended = []
    keys = TerminalKeys(session, lambda: ended.append(True))
    yield keys, session, devices, ended
    keys.close()
    session.close()


def test_each_key_does_what_the_help_says(opened):
    keys, session, devices, ended = opened
    keys.press(b"L")
    wait_until(lambda: devices.light.lit)
    keys.press(b"l")
    wait_until(lambda: not devices.light.lit)
    keys.press(RIGHT)
    wait_until(lambda: devices.stage.at["pan"] == 0.5)
    keys.press(b",")
    assert keys.notice() == "The step is 0.1 degrees."
    keys.press(UP)
    wait_until(lambda: devices.stage.at["tilt"] == pytest.approx(0.1))
    wait_until(lambda: not session.bench.stage.moving)
    keys.press(b"q")
    assert ended


def test_the_level_goes_in_steps(opened):
    keys, session, _, _ = opened
    start = session.bench.light.reading.flicker.level_percent
    assert start == 100.0
    keys.press(b"+")
    wait_until(lambda: "no higher one" in keys.notice())
    for _ in range(5):
        keys.press(b"-")
    wait_until(lambda: session.bench.light.reading.flicker.level_percent == 10.0)
    wait_until(lambda: keys.notice() == "The light's level is 10 %; it is off.")
    keys.press(b"=")
    wait_until(lambda: session.bench.light.reading.flicker.level_percent == 20.0)


def test_a_key_pressed_while_the_devices_open_counts_but_moves_nothing(monkeypatch):
    pytest.importorskip("termios")
    session, devices = fake_session()
    real, ready = session.open, []

    def slow_open():
        wait_until(lambda: "not open yet" in shown[0].notice())
        ready.append(list(devices.stage.calls))
        return real()

    class Keys(TerminalKeys):
        def __init__(self, *args):
            super().__init__(*args)
            shown.append(self)

    shown = []
    session.open = slow_open
    monkeypatch.setattr(serve, "make_session", lambda *_, **__: session)
    monkeypatch.setattr("bench.align.terminal_keys.TerminalKeys", Keys)
    master, slave = os.openpty()
    with os.fdopen(slave, "r") as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        os.write(master, b"\x1b[Cl")  # before the program reads keys at all
        latest = session.latest

        def look():
            if devices.light.lit:
                os.write(master, b"q")
            return latest()

        session.latest = look
        assert serve.align_in_terminal("simulated") == 0
    os.close(master)
    assert "on" in devices.light.calls
    assert ready == [[]]
    assert not any(isinstance(call, tuple) for call in devices.stage.calls)


def test_home_needs_two_presses(opened):
    keys, _, devices, _ = opened
    keys.press(b"h")
    assert "Press H again" in keys.notice()
    time.sleep(0.1)
    assert "home" not in devices.stage.calls
    keys.press(b"h")
    wait_until(lambda: "home" in devices.stage.calls)


def test_a_stop_passes_what_waits(opened):
    keys, session, devices, _ = opened
    keys.press(b"l")
    for _ in range(3):
        keys.press(b".")
        keys.press(RIGHT)
    wait_until(lambda: session.bench.stage.moving)
    keys.press(b" ")
    wait_until(lambda: "stop" in devices.stage.calls, 0.5)


def test_a_refusal_is_shown(opened):
    keys, _, devices, _ = opened
    devices.stage.at["pan"] = 15.0
    keys.press(RIGHT)
    wait_until(lambda: "its limit is 15 deg" in keys.notice())


def test_keys_come_from_a_terminal_and_it_is_left_as_it_was(opened, monkeypatch):
    termios = pytest.importorskip("termios")
    keys, _, devices, ended = opened
    master, slave = os.openpty()
    with os.fdopen(slave, "r") as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        before = termios.tcgetattr(terminal.fileno())
        with keys_of_terminal(keys) as has_keys:
            assert has_keys
            os.write(master, b"l\x1b[Cq")
            wait_until(lambda: devices.light.lit and devices.stage.at["pan"] == 0.5 and ended)
        assert termios.tcgetattr(terminal.fileno()) == before
    os.close(master)


def test_without_a_terminal_there_are_no_keys(opened, monkeypatch, tmp_path):
    (tmp_path / "input").write_text("l")
    with (tmp_path / "input").open() as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        with keys_of_terminal(opened[0]) as has_keys:
            assert not has_keys
    assert not opened[2].light.lit


def test_the_terminal_shows_figures_until_it_is_ended_and_the_bench_is_safe(monkeypatch, capsys):
    session, devices = fake_session()
    monkeypatch.setattr(serve, "make_session", lambda *_, **__: session)
    real = session.latest
    looks = []

    def latest():
        looks.append(True)
        if len(looks) == 3:
            os.kill(os.getpid(), 2)
        return real()

    session.latest = latest
    assert serve.align_in_terminal("simulated") == 0
    assert devices.closed
    assert capsys.readouterr().out.splitlines()[-1] == "camera: closed; it does not record."
