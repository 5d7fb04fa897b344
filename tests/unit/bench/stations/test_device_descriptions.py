"""Descriptions of devices: the shipped ones, every fault at its line and column, and stations that use them."""

from pathlib import Path

import pytest
from station_texts import without

from bench.stations.device_locks import serial_devices
from bench.stations.station import load_station
from bench.stations.station_text import (
    SHIPPED_DESCRIPTIONS,
    description_documents,
    find_description,
)
from bench.stations.text_descriptions import LightProtocol, StageProtocol
from sequences.errors import DocumentFaults
from sequences.reader import read_document

PTU = (SHIPPED_DESCRIPTIONS / "flir_ptu.yaml").read_text()
LIGHT = (SHIPPED_DESCRIPTIONS / "microcontroller_light.yaml").read_text()
STATION = """\
format: starbench/station/1
name: Bench
stage:
  driver: text
  protocol: flir_ptu
  port: /dev/ttyUSB0
  serial: E1042
  axes:
    pan: {address: P, counts_per_deg: 156, limits_deg: [-15, 15], speed_deg_s: 10, acceleration_deg_s2: 50}
    tilt: {address: T, counts_per_deg: 311, limits_deg: [-10, 10], speed_deg_s: 10, acceleration_deg_s2: 50}
light: {driver: text, protocol: microcontroller_light, port: /dev/ttyUSB1, serial: SB0001}
camera: {driver: metavision, serial: 00051234}
"""


def faults_of(path: Path, form=StageProtocol) -> str:
    with pytest.raises(DocumentFaults) as caught:
        read_document(path, form)
    return str(caught.value)


def station_with(folder: Path, old: str, new: str):
    """The station with another line."""
    (folder / "station.yaml").write_text(STATION.replace(old, new, 1))
    return load_station(str(folder / "station.yaml")).value


@pytest.mark.parametrize("path", sorted(SHIPPED_DESCRIPTIONS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_description_is_read(path) -> None:
    form = LightProtocol if "light-protocol" in path.read_text() else StageProtocol
    assert read_document(path, form).value.for_driver().line.maker


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ('reply: "{request} * {counts:integer}"}\n  idle', 'reply: "{request}"}\n  idle', "axis.position.reply: the value is missing"),
        ('"{address}P{target:integer}"', '"{address}P"', "axis.move.send: the value is missing; write {target:...}"),
        ('"{address}P{target:integer}"', '"{adress}P{target:integer}"', "axis.move.send: {adress} needs a kind"),
        ('reply: "{request} *", reply_comes: at_end', "reply_comes: at_end", "axis.home: reply_comes: at_end needs reply"),
        ('{state:integer}", when: [0]', '{state:number}", when: [0], bits: [1]', "axis.idle: bits needs a state that is a whole number"),
        ('send: V, reply: "{request} * {firmware:text}"', "send: V", "identity.reply"),
        ("when: [0]", "when: [idle]", "axis.idle: when must list numbers"),
        ("quantity: speed", "quantity: constant", "axis.settings[3]: a constant needs value"),
        ("reply_s: 0.75", "reply_s: 0.75\n  prompt: é", "line.prompt: must be ASCII characters"),
        ("send: H", 'send: "H{target:integer}"', "stop.send: there is no value 'target' here"),
        ("baudrate: 9600", "baudrate: !!python/object:os.system 9600", "line"),
    ],
)  # fmt: skip
def test_every_fault_of_a_description_is_named_at_its_place(tmp_path, old, new, fault) -> None:
    assert old in PTU
    path = tmp_path / "mine.yaml"
    path.write_text(PTU.replace(old, new, 1))
    message = faults_of(path)
    assert fault in message
    first = PTU[: PTU.index(old)].count("\n") + 1
    assert any(f"mine.yaml:{line}:" in message for line in range(first - 3, first + 4))


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("words: {square: square, steady: steady}", "words: {square: s, round: r}", "words of this setting: sine, square, steady"),
        ("words: {square: square, steady: steady}", "words: {square: s, steady: s}", "two words are the same"),
        ('{value:word}"}\n  - quantity: frequency', '{value:integer}"}\n  - quantity: frequency', "words must be numbers"),
        ("range: [0.5, 5000]", "range: [5000, 0.5]", "range must be [lowest, highest]"),
        ("quantity: level_percent", "quantity: duty_percent", "settings needs level_percent"),
        ("value: 900", "factor: 900", "a constant needs value"),
    ],
)  # fmt: skip
def test_a_lights_faults_are_named_too(tmp_path, old, new, fault) -> None:
    assert old in LIGHT
    path = tmp_path / "mine.yaml"
    path.write_text(LIGHT.replace(old, new, 1))
    assert fault in faults_of(path, LightProtocol)


def test_a_missing_shipped_description_is_named() -> None:
    with pytest.raises(DocumentFaults, match="flir_ptu"):
        find_description("flir_pt", None)


def test_a_station_uses_descriptions_beside_it_and_its_devices_are_locked_by_their_numbers(tmp_path) -> None:
    (tmp_path / "mine.yaml").write_text(PTU.replace("maker: FLIR", "maker: Mine"))
    station = station_with(tmp_path, "protocol: flir_ptu", "protocol: mine.yaml")
    assert station.stage.described.maker == "Mine"
    assert serial_devices(station) == ("Mine E1042", "Starbench SB0001")
    kept = description_documents(station)
    assert kept == {
        "protocol-stage.yaml": (tmp_path / "mine.yaml").read_bytes(),
        "protocol-light.yaml": LIGHT.encode(),
    }


def test_a_run_folder_uses_its_own_copies(tmp_path) -> None:
    (tmp_path / "protocol-stage.yaml").write_text(PTU.replace("maker: FLIR", "maker: Copied"))
    station = station_with(tmp_path, "protocol: flir_ptu", "protocol: gone.yaml")
    assert station.stage.described.maker == "Copied"


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("protocol: flir_ptu", "protocol: gone.yaml", "station.yaml:5:13: stage.protocol: there is no file"),
        ("protocol: flir_ptu", "protocol: microcontroller_light", "wrong kind of document"),
        ("{address: P, ", "{", "stage.axes.pan: address is missing"),
        ("address: T", "address: P", "two axes have the same address"),
        ("counts_per_deg: 156", "counts_per_deg: 0", "a scale of 0 moves nothing"),
    ],
)  # fmt: skip
def test_a_section_that_does_not_fit_its_description_is_refused(tmp_path, old, new, fault) -> None:
    with pytest.raises(DocumentFaults) as caught:
        station_with(tmp_path, old, new)
    assert fault in str(caught.value)


def test_an_axis_of_which_a_reply_tells_nothing_is_named(tmp_path) -> None:
    (tmp_path / "mine.yaml").write_text(
        PTU.replace('{counts:integer}"}', '{counts_p:integer} {counts_x:integer}"}', 1)
    )
    with pytest.raises(DocumentFaults, match="axis 'T'"):
        station_with(tmp_path, "protocol: flir_ptu", "protocol: mine.yaml")


def test_a_light_without_sync_output_and_a_device_without_serial_number_are_told(tmp_path) -> None:
    (tmp_path / "mine.yaml").write_text(without(LIGHT[: LIGHT.index("  - quantity: sync")], "serial"))
    with pytest.raises(DocumentFaults) as caught:
        station_with(tmp_path, "protocol: microcontroller_light", "protocol: mine.yaml")
    assert "sync_output: false" in str(caught.value)
    assert "a serial number" in str(caught.value)
