"""The contract tests of Starbench, for this driver."""

from collections.abc import Callable
from typing import Any, ClassVar

from starbench_turntable.simulated import SimulatedTurntable

from bench.extras.plugin_tests import StageContract


class TestTurntable(StageContract):
    """Every test of the suite."""

    section: ClassVar[dict[str, Any]] = {
        "driver": "turntable",
        "port": "PORT",
        "serial": "T7",
        "axes": {"pan": {"limits_deg": [-90, 90], "speed_deg_s": 30, "acceleration_deg_s2": 1000}},
    }
    other_serial = "T8"

    def device(self, clock: Callable[[], float]) -> SimulatedTurntable:
        """Return a turntable, fresh from power-up."""
        return SimulatedTurntable(clock)
