"""Real ports: pseudo-terminals that are held, refused, unplugged and plugged in again."""

import os
import pty
import signal
import socket
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import pytest
import serial
import serial.rfc2217
from running import killed_at_end, start_python

from drivers.clock import SystemClock
from drivers.errors import PortBusy, PortDenied, PortLost, PortNotFound
from drivers.link import Link
from drivers.serial_port import LineSettings, SerialPort

HOLD = """
import sys, time
from drivers.serial_port import LineSettings, SerialPort
port = SerialPort(sys.argv[1], LineSettings(9600))
print("held", flush=True)
time.sleep(600)
"""


class Plug:
    """A pseudo-terminal under a name that stays, as /dev/serial/by-id does."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.plug()

    def plug(self) -> None:
        self.ours, self.theirs = pty.openpty()
        tty.setraw(self.theirs)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self.theirs))

    def unplug(self) -> None:
        os.close(self.ours)
        os.close(self.theirs)
        self.ours = self.theirs = -1

    def close(self) -> None:
        if self.ours >= 0:
            self.unplug()


@pytest.fixture
def plug(tmp_path) -> Iterator[Plug]:
    plug = Plug(tmp_path / "device")
    yield plug
    plug.close()


@pytest.fixture
def port(plug) -> Iterator[SerialPort]:
    port = SerialPort(str(plug.link), LineSettings(115200))
    yield port
    port.close()


def test_opening_sends_nothing(plug, port) -> None:
    os.set_blocking(plug.ours, False)
    with pytest.raises(BlockingIOError):
        os.read(plug.ours, 1)


def test_closing_leaves_the_modem_lines_up(plug, port) -> None:
    assert not termios.tcgetattr(plug.theirs)[2] & termios.HUPCL


def test_a_port_is_opened_once_only_in_one_process(plug, port) -> None:
    with pytest.raises(PortBusy, match="another program"):
        SerialPort(str(plug.link), LineSettings(9600))


def test_a_second_process_is_refused_and_a_killed_one_leaves_no_lock(plug) -> None:
    with killed_at_end(start_python("-c", HOLD, plug.link)) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(PortBusy):
            SerialPort(str(plug.link), LineSettings(9600))
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        os.set_blocking(plug.ours, False)
        with pytest.raises(BlockingIOError):
            os.read(plug.ours, 1)
        SerialPort(str(plug.link), LineSettings(9600)).close()


def test_a_missing_port_is_named_with_its_remedy(tmp_path) -> None:
    with pytest.raises(PortNotFound, match=r"nowhere: .*no such port"):
        SerialPort(str(tmp_path / "nowhere"), LineSettings(9600))


def test_no_permission_is_told_with_its_remedy(plug, monkeypatch) -> None:
    def refuse(*arguments):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("serial.serialposix.os.open", refuse)
    with pytest.raises(PortDenied, match="dialout"):
        SerialPort(str(plug.link), LineSettings(9600))


def read_on(port: SerialPort) -> None:
    while True:
        port.read(30.0)


@pytest.mark.parametrize(
    "action",
    [lambda port: port.read(5.0), lambda port: port.read(0.0), lambda port: port.write(b"x\n"), read_on],
    ids=["read", "read without waiting", "write", "read on"],
)
def test_an_unplugged_port_is_lost_whatever_is_done_with_it(plug, port, action) -> None:
    plug.unplug()
    with pytest.raises(PortLost, match="the port is gone"):
        action(port)
    with pytest.raises(PortLost, match="lost before"):
        port.write(b"x\n")
    port.close()


def test_after_replugging_the_same_name_is_opened_anew(plug, port) -> None:
    plug.unplug()
    with pytest.raises(PortLost):
        port.read(1.0)
    port.close()
    plug.plug()
    again = SerialPort(str(plug.link), LineSettings(9600))
    again.write(b"hello\n")
    assert os.read(plug.ours, 100) == b"hello\n"
    again.close()


def test_a_socket_serves_as_a_port() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = SerialPort(f"socket://127.0.0.1:{server.getsockname()[1]}", LineSettings(9600))
        peer, _ = server.accept()
        port.write(b"over the net\n")
        assert peer.recv(100) == b"over the net\n"
        peer.sendall(b"and back\n")
        data = b""
        while len(data) < 9:
            data += port.read(5.0)
        assert data == b"and back\n"
        peer.close()
        with pytest.raises(PortLost):
            read_on(port)
        port.close()


class InStep(Link):
    """A line that is never out of step."""

    def _resynchronise(self) -> None:
        raise AssertionError


def test_threads_take_turns_on_one_line(plug, port) -> None:
    def echo() -> None:
        served = 0
        while served < 80:
            data = os.read(plug.ours, 100)
            os.write(plug.ours, data)
            served += data.count(b"\n")

    link = InStep(port, clock=SystemClock())

    def ask(name: str) -> None:
        for number in range(20):
            text = f"{name}{number}\n".encode()
            assert link.exchange(text, lambda reader: reader.read_line(), deadline_s=30.0) == text

    with ThreadPoolExecutor(5) as pool:
        for done in [pool.submit(echo), *(pool.submit(ask, name) for name in "abcd")]:
            done.result()


class DeviceServer:
    """A serial device server as RFC 2217 has it, before a plug that returns what is sent to it, or another port."""

    def __init__(self) -> None:
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.address = f"rfc2217://127.0.0.1:{self.listening.getsockname()[1]}"
        self.device = serial.serial_for_url("loop://", timeout=0.05)
        self.client = None
        self.thread = threading.Thread(target=self.serve, daemon=True)
        self.thread.start()

    def serve(self) -> None:
        self.client, _ = self.listening.accept()
        self.client.settimeout(0.01)
        manager = serial.rfc2217.PortManager(self.device, self)
        try:
            while True:
                try:
                    data = self.client.recv(1024)
                except TimeoutError:
                    data = b""
                else:
                    if not data:
                        return
                self.device.write(b"".join(manager.filter(data)))
                if waiting := self.device.in_waiting:
                    self.client.sendall(b"".join(manager.escape(self.device.read(waiting))))
        except OSError:  # we hung up
            self.client.close()

    def write(self, data: bytes) -> None:
        self.client.sendall(data)

    def hang_up(self) -> None:
        self.client.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.thread.join(5.0)
        assert not self.thread.is_alive()
        self.client.close()
        self.listening.close()
        self.device.close()


of_pyserial = pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")  # it calls them


def write_on(port: SerialPort) -> None:
    while True:
        port.write(b"x" * 4096)
        time.sleep(0.02)


@pytest.fixture
def serve() -> Iterator[Callable[..., tuple[DeviceServer, SerialPort]]]:
    """A server, and a port to the device behind it."""
    with ExitStack() as stack:

        def serving() -> tuple[DeviceServer, SerialPort]:
            server = DeviceServer()
            stack.callback(server.close)
            port = SerialPort(server.address, LineSettings(19200))
            stack.callback(port.close)
            return server, port

        yield serving


@of_pyserial
def test_a_device_server_serves_as_a_port_and_takes_its_baud_rate(serve) -> None:
    server, port = serve()
    port.write(b"there and back\n")
    data = b""
    while len(data) < 15:
        data += port.read(5.0)
    assert data == b"there and back\n"
    assert server.device.baudrate == 19200


@of_pyserial
@pytest.mark.parametrize("act", [lambda port: port.read(120.0), write_on], ids=["read", "write on"])
def test_a_device_server_that_hangs_up_is_a_lost_port(serve, act) -> None:
    server, port = serve()
    server.hang_up()
    with pytest.raises(PortLost):
        act(port)
