"""What is connected, and the station file drafted from it."""

import types

import pytest

from bench import discovery
from bench.discovery import Discovery, FoundPort, discover
from bench.station import load_station
from bench.station_draft import ASK, STAGES, draft_station
from drivers.camera import FoundCamera

PORTS = (
    FoundPort("/dev/serial/by-id/zaber", "/dev/ttyUSB0", "X-USBDC", "A1", ""),
    FoundPort("/dev/ttyS1", "/dev/ttyS1", "", "", ""),
)


def test_a_port_is_called_by_its_id_where_it_has_one(tmp_path, monkeypatch):
    device = tmp_path / "ttyUSB0"
    device.touch()
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    (by_id / "usb-Zaber-if00").symlink_to(device)
    infos = [types.SimpleNamespace(device=str(device), description="X-USBDC", serial_number="A1")]
    monkeypatch.setattr(discovery.list_ports, "comports", lambda: infos)
    monkeypatch.setattr(discovery, "find_cameras", lambda: ([FoundCamera("metavision", "00051", "EVK4")], []))
    found = discover(by_id)
    assert [(port.name, port.note) for port in found.ports] == [(str(by_id / "usb-Zaber-if00"), "")]
    assert found.cameras[0].serial == "00051"
    assert found.missing == ()


def test_what_is_missing_is_said(monkeypatch, tmp_path):
    monkeypatch.setattr(discovery.list_ports, "comports", list)
    monkeypatch.setattr(discovery, "find_cameras", lambda: ([], ["OpenEB is not installed."]))
    found = discover(tmp_path / "none")
    assert found.missing == (
        "OpenEB is not installed.",
        "No serial port was found: plug in the stage's and the light's adapters.",
    )


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("ports", [(), PORTS])
def test_a_draft_reads_without_a_fault_and_names_what_is_connected(tmp_path, stage, ports):
    found = Discovery(ports, (FoundCamera("neuromorphic_evk4", "00051", "EVK4"),) if ports else (), ())
    path = tmp_path / "bench.yaml"
    path.write_text(draft_station("Cellar", found, stage=stage))
    station = load_station(str(path)).value
    assert station.stage.driver == stage
    assert station.camera.serial == ("00051" if ports else ASK)
    if ports:
        assert station.stage.ports[0] == "/dev/serial/by-id/zaber"
        assert station.light.port == "/dev/ttyS1"
