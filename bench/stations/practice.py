"""A station file whose devices are all stand-ins: they run on the simulated bench, and are asked as real ones are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from bench.base.clock import BenchClock
from bench.simulated import SimulatedBench
from bench.stations.asked_devices import AskedAxis, AskedStage, ask_light, ask_stage
from bench.stations.discovery import Discovery
from bench.stations.sections import EventCameraSection
from bench.stations.stages_and_lights import ScpiLightConfig
from bench.stations.station import load_station
from bench.stations.station_draft import StandIns, draft_station

STAND_IN_LIGHTS: Final[Mapping[str, str]] = {
    "keysight": "scpi",
    "rigol": "scpi",
    "siglent": "scpi",
    "gardasoft": "gardasoft",
    "microcontroller": "text",
}
"""Simulated lights by make or kind, with the driver of each."""
_GRBL_LIMIT_DEG = 14.0  # The machine position 0 is then at the angle that a new station file states
_STAGES: Final[Mapping[str, tuple[Mapping[str, Any], float | None]]] = {
    "zaber_ascii": ({"kind": "zaber"}, 6400.0),
    "ximc": ({"kind": "ximc"}, 100.0),
    "grbl": (
        {
            "kind": "grbl",
            "left_behind": ["$I=gimbal-1"],
            "pan": {"limit_deg": _GRBL_LIMIT_DEG},
            "tilt": {"limit_deg": _GRBL_LIMIT_DEG},
        },
        None,
    ),
    "esp30x": ({"kind": "esp301"}, None),
    "thorlabs_apt": (
        {"kind": "thorlabs_apt", "pan": {"serial": "27000101"}, "tilt": {"serial": "27000102"}},
        409_600 / 3,
    ),
    "text": ({"kind": "flir_ptu", "pan": {"serial": "E1042"}, "tilt": {"limit_deg": 15.0}}, 800.0),
}
"""Simulated stages by driver, with the scale that a data sheet states; None where the controller states it."""


def draft_stand_ins(light: str, stage: str = "zaber_ascii") -> str:
    """Return a station file with a light of `STAND_IN_LIGHTS`, a stage by its driver, and the simulated camera."""
    shipped = load_station("simulated").value
    assert isinstance(shipped.light, ScpiLightConfig)
    assert isinstance(shipped.camera, EventCameraSection)
    section, scale = _STAGES[stage]
    simulation = {"stage": section, "light": {"kind": light}}
    clock = BenchClock()
    with SimulatedBench(simulation, 1) as bench:
        ports = {port: name for name, port in bench.endpoints.items()}
        answered = ask_stage(
            stage, [port for port, name in ports.items() if name.startswith("gimbal")], clock
        )
        lamp = ask_light(STAND_IN_LIGHTS[light], [bench.endpoints["light"]], clock)
    return draft_station(
        Discovery((), (), ()),
        stage=stage,
        light=STAND_IN_LIGHTS[light],
        asked=(_with_scale(answered, ports, scale) if answered else None, lamp),
        stand_ins=StandIns(simulation, shipped.camera.serial or "", shipped.light.high_v, scale),
    )


def _with_scale(stage: AskedStage, ports: Mapping[str, str], scale: float | None) -> AskedStage:
    """Return a stage by the names of the simulated ports, with the scale of its data sheet."""

    def known(axis: AskedAxis) -> AskedAxis:
        return replace(
            axis,
            microsteps_per_deg=axis.microsteps_per_deg or scale,
            port=f"sim:{ports[axis.port]}" if axis.port else "",
        )

    return AskedStage(f"sim:{ports[stage.port]}", [known(axis) for axis in stage.axes])
