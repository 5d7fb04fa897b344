"""Every kind of stage, built from one configuration, points where its own commands ask."""

import pytest

from simulators.assembly import make_stage
from simulators.config import bench_config
from tests.hil.direct_stages import VirtualClock


@pytest.mark.parametrize(
    ("kind", "home", "to_the_limit", "beyond", "limit_deg"),
    [
        ("zaber", b"/0 0 home\n", b"/1 1 move abs 64000\n", b"/1 1 move abs 64001\n", 10.0),
        ("grbl", b"$H\n", b"G0 X-21\n", b"G0 X-21.01\n", -10.0),
        ("esp301", b"1MO;1OR\r", b"1PA10\r", b"1PA10.001\r", 10.0),
    ],
)
def test_soft_limits_are_those_of_the_configuration(kind, home, to_the_limit, beyond, limit_deg):
    clock, pointing = VirtualClock(), {}
    axes = bench_config({"stage": {"kind": kind, "pan": {"limit_deg": 10}, "tilt": {}}}).axes
    device = make_stage(kind, axes, clock.monotonic, pointing.__setitem__).dialects["gimbal"]
    for message in (home, to_the_limit, beyond):
        device.receive(message)
        for _ in range(100):
            clock.sleep(0.2)
            device.unsolicited()
        assert message == home or pointing["pan"].angle_deg(clock.now_s) == limit_deg
