"""The simulated servos, and our packets, against the maker's client (`dynamixel_sdk`, Apache-2.0)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.stage import dynamixel_bus as ours
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice
from simulators.stages.axis_motion import AxisModel, Mechanics
from simulators.stages.dynamixel import DynamixelBus, crc_of, status_packet, unstuffed

sdk = pytest.importorskip("dynamixel_sdk", reason="pip install dynamixel-sdk")
SUCCESS = 0


class HandClock:
    """The time of the servos: it passes where a test says so."""

    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def bus(clock) -> DynamixelBus:
    model = AxisModel(Mechanics(4096 / 360, -170.0, 170.0, start_deg=10.0))
    bus = DynamixelBus({1: model, 2: model}, clock)
    clock.now_s += 1.0
    return bus


@pytest.fixture
def client(bus, tmp_path: Path) -> Iterator[tuple]:
    with SerialDevice(PseudoTerminal(tmp_path / "u2d2"), bus) as device:
        port = sdk.PortHandler(device.address)
        assert port.openPort()
        assert port.setBaudRate(57_600)
        port.getCurrentTime = lambda: time.monotonic() * 1000.0
        port.ser.timeout = 0.05
        yield sdk.PacketHandler(2.0), port
        port.closePort()


def test_the_maker_s_client_pings_reads_writes_moves_and_reboots(client, clock) -> None:
    packets, port = client
    assert packets.ping(port, 1) == (1060, SUCCESS, 0)
    assert packets.ping(port, 7)[1] == sdk.COMM_RX_TIMEOUT
    found, result = packets.broadcastPing(port)
    assert (sorted(found), result) == ([1, 2], SUCCESS)
    assert packets.read4ByteTxRx(port, 1, 132) == (round(10.0 * 4096 / 360) + 2048, SUCCESS, 0)
    assert packets.write1ByteTxRx(port, 1, 11, 4) == (SUCCESS, 0)
    assert packets.write4ByteTxRx(port, 1, 108, 40) == (SUCCESS, 0)
    assert packets.write4ByteTxRx(port, 1, 112, 100) == (SUCCESS, 0)
    assert packets.write4ByteTxRx(port, 1, 116, 3000) == (SUCCESS, 0)
    clock.now_s += 1.0
    assert packets.read4ByteTxRx(port, 1, 132)[0] == 2162, "without torque, a goal moves nothing"
    assert packets.write1ByteTxRx(port, 1, 64, 1) == (SUCCESS, 0)
    assert packets.write1ByteTxRx(port, 1, 11, 3)[1] == 7, "modes cannot be set while the torque is on"
    assert packets.write4ByteTxRx(port, 1, 116, 2400) == (SUCCESS, 0)
    assert packets.read1ByteTxRx(port, 1, 122)[0] == 1
    clock.now_s += 5.0
    assert packets.read1ByteTxRx(port, 1, 122)[0] == 0
    assert packets.read4ByteTxRx(port, 1, 132)[0] == 2400
    assert packets.write4ByteTxRx(port, 1, 112, 30_000)[1] == 6, "faster than the limit of the servo"
    assert packets.write2ByteTxRx(port, 1, 132, 0)[1] == 7, "read-only"
    assert packets.reboot(port, 1) == (SUCCESS, 0)
    clock.now_s += 0.6
    assert packets.read1ByteTxRx(port, 1, 64) == (0, SUCCESS, 0)
    assert packets.read4ByteTxRx(port, 1, 132)[0] == 2400
    assert packets.read1ByteTxRx(port, 1, 11)[0] == 4


def test_the_maker_s_client_reads_and_writes_two_servos_at_once(client, clock) -> None:
    packets, port = client
    for number in (1, 2):
        assert packets.write1ByteTxRx(port, number, 11, 4) == (SUCCESS, 0)
        assert packets.write1ByteTxRx(port, number, 64, 1) == (SUCCESS, 0)
    write = sdk.GroupSyncWrite(port, packets, 116, 4)
    for number, goal in ((1, 2100), (2, 2200)):
        assert write.addParam(number, list(goal.to_bytes(4, "little")))
    assert write.txPacket() == SUCCESS
    assert packets.ping(port, 1)[1] == SUCCESS, "nobody answers a group, so it may not have been read yet"
    clock.now_s += 1.0
    read = sdk.GroupSyncRead(port, packets, 132, 4)
    assert read.addParam(1)
    assert read.addParam(2)
    assert read.txRxPacket() == SUCCESS
    assert [read.getData(number, 132, 4) for number in (1, 2)] == [2100, 2200]


def test_an_overloaded_servo_tells_the_maker_s_client(client, bus, clock) -> None:
    packets, port = client
    packets.write1ByteTxRx(port, 2, 64, 1)
    bus.servos[2].shut_down(0x20, clock.now_s)
    value, result, error = packets.read1ByteTxRx(port, 2, 70)
    assert (value, result, error & 0x80) == (0x20, SUCCESS, 0x80)
    assert packets.read1ByteTxRx(port, 2, 64)[0] == 0


def test_our_crcs_and_packets_are_the_maker_s() -> None:
    rng = np.random.default_rng(1)
    theirs = sdk.PacketHandler(2.0)
    for length in rng.integers(3, 90, 300).tolist():
        data = rng.choice([0xFF, 0xFD, 0x00, 0x55, 7], length).astype(np.uint8).tobytes()
        expected = theirs.updateCRC(0, data, len(data))
        assert ours.crc16(data) == expected
        assert crc_of(data) == expected

        packet = [*b"\xff\xff\xfd\x00", 1, (len(data) + 3) & 0xFF, (len(data) + 3) >> 8, 3, *data, 0, 0]
        packet = theirs.addStuffing(packet)  # its own txPacket drops what this returns
        crc = theirs.updateCRC(0, packet[:-2], len(packet) - 2)
        assert ours.packet(1, ours.WRITE, data) == bytes([*packet[:-2], crc & 0xFF, crc >> 8])
        assert unstuffed(bytes(packet[7:-2])) == bytes([3]) + data

        said = list(status_packet(1, 0, data))
        assert ours.parse(bytes(said), "").content == b"\0" + data
        # The maker's loop compares with bytes that it has moved already, so only one header among other bytes is fair.
        one = rng.choice([0xFF, 0x00, 7], length).astype(np.uint8).tobytes()
        one = one[: length // 2] + b"\xff\xff\xfd" + one[length // 2 :].lstrip(b"\xff")
        bare = theirs.removeStuffing(list(status_packet(1, 0, one)))
        assert bytes(bare[9 : 9 + len(one)]) == one
