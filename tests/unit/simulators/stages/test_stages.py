"""Every kind of stage, built from one configuration, points where its own commands ask."""

import pytest

from simulators.assembly import Stage, make_stage
from simulators.config import bench_config
from simulators.ports.serial_device import Dialect
from simulators.world.trajectory import LoadTrajectory


class Built:
    """A stage on a clock that the test advances, and where its axes point."""

    def __init__(self, kind: str, **changes) -> None:
        config = bench_config({"stage": {"kind": kind, "pan": {**changes}, "tilt": {}}})
        self.now_s = 0.0
        self.pointing: dict[str, LoadTrajectory] = {}
        self.stage: Stage = make_stage(kind, config.axes, lambda: self.now_s, self.pointing.__setitem__)

    def say(self, port: str, *messages: bytes) -> bytes:
        """Send messages one after the other, wait long after each, and return the last answer."""
        dialect: Dialect = self.stage.dialects[port]
        answer = b""
        for message in messages:
            answer = dialect.receive(message)
            for _ in range(100):
                self.now_s += 0.2
                answer += dialect.unsolicited()
        return answer

    def angles(self) -> dict[str, float]:
        return {name: pointing.angle_deg(self.now_s) for name, pointing in self.pointing.items()}


@pytest.mark.parametrize(
    ("kind", "home", "to_the_limit", "beyond", "limit_deg"),
    [
        ("zaber", b"/0 0 home\n", b"/1 1 move abs 64000\n", b"/1 1 move abs 64001\n", 10.0),
        ("grbl", b"$H\n", b"G0 X-21\n", b"G0 X-21.01\n", -10.0),
        ("esp301", b"1MO;1OR\r", b"1PA10\r", b"1PA10.001\r", 10.0),
    ],
)
def test_soft_limits_are_those_of_the_configuration(kind, home, to_the_limit, beyond, limit_deg):
    built = Built(kind, limit_deg=10)
    built.say("gimbal", home, to_the_limit)
    assert built.angles()["pan"] == limit_deg
    built.say("gimbal", beyond)
    assert built.angles()["pan"] == limit_deg
