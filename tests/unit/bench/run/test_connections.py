"""What camera and light answer about their cables is asked before a run, and told as what it is."""

from types import SimpleNamespace

import pytest

from bench.report import run_tables
from bench.run.states import NOT_STATED, connections
from drivers.camera import CameraIdentity

EVK4 = CameraIdentity("Prophesee", "EVK4", "IMX636", "00051234", "3.9.0", 1280, 720)


@pytest.mark.parametrize(
    ("link_mbit_s", "told"),
    [
        (None, NOT_STATED),
        (480, "480 Mbit/s (USB 2)"),
        (5000, "5000 Mbit/s (USB 3)"),
        (10000, "10000 Mbit/s (USB 3)"),
    ],
)
def test_the_speed_of_the_connection_is_told(link_mbit_s, told):
    camera = CameraIdentity(**{**vars(EVK4), "link_mbit_s": link_mbit_s})
    assert connections(camera, {"trigger_in": True}, SimpleNamespace())["camera_link"] == told


def test_what_a_device_does_not_state_is_said_to_be_so():
    nothing = CameraIdentity("", "", "", "1", "", 10, 10)
    assert connections(nothing, {"trigger_in": False}, SimpleNamespace()) == {
        "camera_link": NOT_STATED,
        "camera_firmware": NOT_STATED,
        "trigger_input": "off",
        "sync_polarity": NOT_STATED,
        "sync_level": NOT_STATED,
    }


def test_firmware_and_polarity_are_told_and_printed():
    camera = CameraIdentity(**{**vars(EVK4), "firmware_built": "Thu Jan  5 10:11:12 2023"})
    light = SimpleNamespace(sync_polarity=lambda: "normal")
    found = connections(camera, {"trigger_in": True}, light)
    assert found["camera_firmware"] == "3.9.0, built Thu Jan  5 10:11:12 2023"
    rows = dict(run_tables.connections({"connections": found}))
    assert rows["sync polarity"] == "normal"
    assert rows["trigger input"] == "on"
    assert run_tables.connections({}) == []
