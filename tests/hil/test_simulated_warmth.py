"""Temperature of the simulated camera over its socket: the host reads the temperature that the lens follows."""

from datetime import UTC, datetime

import pytest

from drivers.camera.simulated_evk4 import SimulatedEvk4Camera
from drivers.clock import SystemClock
from simulators.cameras.evk4 import SimulatedEvk4
from simulators.config import bench_config
from simulators.world.world import World


def test_the_reported_temperature_is_the_one_that_the_focal_length_follows():
    config = bench_config({"thermal": {"room_c": 21, "warm_up_min": 10, "focal_ppm_per_c": 20}})
    now = [50.0]
    world = World(config.truth, clock=lambda: now[0])
    camera = SimulatedEvk4(world)
    camera.start()
    try:
        host = SimulatedEvk4Camera.open(
            camera.address, clock=SystemClock(), utc_now=lambda: datetime.now(UTC)
        )
        reported = []
        for on_s in (0.0, 600.0, 7200.0):
            now[0] = 50.0 + on_s
            reported.append(host.temperature_c())
            law = 1.0 + 20e-6 * (reported[-1] - 41.5)
            assert world.truth_at(now[0]).camera.fx == pytest.approx(config.truth.camera.fx * law, rel=1e-12)
        host.close()
    finally:
        camera.close()
    assert reported == [
        21.0,
        pytest.approx(21.0 + 18.0 * (1.0 - 0.36788), abs=0.006),
        pytest.approx(39.0, abs=0.01),
    ]
