"""A station file whose devices are all stand-ins: they run on the simulated bench, and are asked as real ones are."""

from __future__ import annotations

from bench.base.clock import BenchClock
from bench.simulated import SimulatedBench
from bench.stations.asked_devices import ask_light, ask_stage
from bench.stations.discovery import Discovery
from bench.stations.sections import EventCameraSection
from bench.stations.stages_and_lights import ScpiLightConfig, ZaberStageConfig
from bench.stations.station import load_station
from bench.stations.station_draft import StandIns, draft_station


def draft_stand_ins(light: str) -> str:
    """Return a station file with the devices of the simulated bench; ``light`` is the make of the generator."""
    shipped = load_station("simulated").value
    assert isinstance(shipped.stage, ZaberStageConfig)
    assert isinstance(shipped.light, ScpiLightConfig)
    assert isinstance(shipped.camera, EventCameraSection)
    clock = BenchClock()
    # The scale of a goniometer is on its data sheet only; the shipped station states that of the simulated one.
    scale = next(iter(shipped.stage.axes.values())).microsteps_per_deg
    with SimulatedBench({"light": {"kind": light}}, 1) as bench:
        stage = ask_stage("zaber_ascii", [bench.endpoints["gimbal"]], clock, scale)
        generator = ask_light("scpi", [bench.endpoints["light"]], clock)
    return draft_station(
        Discovery((), (), ()),
        stage="zaber_ascii",
        asked=(stage, generator),
        stand_ins=StandIns(light, shipped.camera.serial or "", shipped.light.high_v),
    )
