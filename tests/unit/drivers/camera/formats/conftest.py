"""A recording that is converted."""

import pytest

from drivers.camera.formats.event_conversion import Evt3Encoder
from tests.support.made_event_files import drawn_stream

HEADER = (
    b"% date 2026-03-01 12:00:00\n% format EVT3;height=720;width=1280\n% integrator_name Prophesee\n"
    b"% sensor_name IMX636\n% serial_number 00051234\n% end\n"
)


@pytest.fixture
def raw(tmp_path):
    path = tmp_path / "pose.raw"
    path.write_bytes(HEADER + Evt3Encoder().words(*drawn_stream()).tobytes())
    return path
