"""Builds the simulated stages and the driver of the light from their configuration.

This module knows which controllers each kind of stage has, on which ports they answer, and which controller moves
which axis; and which device each kind of light stands for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

from simulators.config import AxisConfig, LightConfig
from simulators.faults.fault_injection import AxisController
from simulators.lights.driver import LightDriver
from simulators.lights.gardasoft import GardasoftRt
from simulators.lights.generators import GeneratorModel, ScpiGenerator
from simulators.lights.microcontroller import MicrocontrollerLight
from simulators.lights.siglent import SiglentGenerator
from simulators.ports.serial_device import Dialect
from simulators.stages.axis_motion import AxisModel, AxisOfController, Mechanics, SingleController
from simulators.stages.esp301 import EspController
from simulators.stages.flir_ptu import PtuController
from simulators.stages.grbl import GrblController
from simulators.stages.thorlabs_apt import AptController
from simulators.stages.ximc import XimcController
from simulators.stages.zaber import ZaberChain, ZaberController
from simulators.world.trajectory import LoadTrajectory
from simulators.world.world import AxisName, LightState

#: Distance of the end stops beyond the soft limits, degrees.
_STOP_MARGIN_DEG: Final = 2.0

#: A GRBL axis homes at its upper soft limit, this far below its switch, degrees.
_PULL_OFF_DEG: Final = 1.0

#: Scales that are no whole numbers, by the whole number that the configuration gives: a K10CR1.
_EXACT_SCALES: Final = {136_533: 409_600 / 3}

Axes = Mapping[AxisName, AxisConfig]
Clock = Callable[[], float]
Publish = Callable[[AxisName, LoadTrajectory], None]


@dataclass(frozen=True)
class Stage:
    """A stage, ready to be connected to its ports."""

    dialects: Mapping[str, Dialect]
    controllers: Mapping[str, AxisController]
    ports: Mapping[str, str]


def make_stage(kind: str, axes: Axes, clock: Clock, publish: Publish) -> Stage:
    """Build a stage of a kind in `simulators.config.STAGE_KINDS`; its axes in the order of their addresses."""
    return _MAKERS[kind](axes, clock, publish)


def _model(axis: AxisConfig, *, home_deg: float = 0.0, notices_stalls: bool = True) -> AxisModel:
    mechanics = Mechanics(
        counts_per_deg=_EXACT_SCALES.get(axis.microsteps_per_deg, float(axis.microsteps_per_deg)),
        lowest_deg=-axis.limit_deg - _STOP_MARGIN_DEG,
        highest_deg=axis.limit_deg + _STOP_MARGIN_DEG,
        home_deg=home_deg,
        start_deg=axis.start_deg,
        settle_s=axis.settle_s,
        backlash_deg=axis.backlash_deg,
        stall_detection=notices_stalls,
    )
    return AxisModel(
        mechanics, axis.serial, axis.limit_deg, axis.speed_deg_s, axis.acceleration_deg_s2, axis.encoder
    )


def _on_one_port(dialect: Dialect, controllers: Mapping[AxisName, AxisController]) -> Stage:
    named = {str(name): controller for name, controller in controllers.items()}
    return Stage({"gimbal": dialect}, named, dict.fromkeys(named, "gimbal"))


def _on_own_ports(
    make: type[SingleController],
    axes: Axes,
    clock: Clock,
    publish: Publish,
    *,
    notices_stalls: bool = True,
) -> Stage:
    """Build one controller with its own port for each axis."""
    named = {
        str(name): make(_model(axis, notices_stalls=notices_stalls), clock, partial(publish, name))
        for name, axis in axes.items()
    }
    ports = {name: f"gimbal-{name}" for name in named}
    return Stage({port: named[name] for name, port in ports.items()}, named, ports)


def _zaber(axes: Axes, clock: Clock, publish: Publish) -> Stage:
    """Build X-RST controllers chained on one line."""
    controllers = {
        name: ZaberController(_model(axis), clock(), partial(publish, name)) for name, axis in axes.items()
    }
    return _on_one_port(ZaberChain([*controllers.values()], clock), controllers)


def _grbl(axes: Axes, clock: Clock, publish: Publish) -> Stage:
    """Build one board for all axes, lettered X, Y and Z in their order."""
    names = dict(zip("XYZ", axes, strict=False))
    models = {
        letter: _model(axes[name], home_deg=axes[name].limit_deg, notices_stalls=False)
        for letter, name in names.items()
    }
    board = GrblController(
        models, clock, lambda letter, pointing: publish(names[letter], pointing), _PULL_OFF_DEG
    )
    return _on_one_port(
        board, {name: AxisOfController(board, board.axes[letter]) for letter, name in names.items()}
    )


def _esp301(axes: Axes, clock: Clock, publish: Publish) -> Stage:
    """Build one controller for all axes, numbered in their order."""
    names = dict(enumerate(axes, start=1))
    models = [_model(axis) for axis in axes.values()]
    controller = EspController(models, clock, lambda number, pointing: publish(names[number], pointing))
    return _on_one_port(controller, {name: controller.axes[number] for number, name in names.items()})


def _flir_ptu(axes: Axes, clock: Clock, publish: Publish) -> Stage:
    """Build one unit for the first two axes, lettered P and T in their order."""
    names = dict(zip("PT", axes, strict=False))
    models = {letter: _model(axes[name], notices_stalls=False) for letter, name in names.items()}
    serial = next(iter(axes.values())).serial
    unit = PtuController(models, serial, clock, lambda letter, pointing: publish(names[letter], pointing))
    return _on_one_port(unit, {name: unit.axes[letter] for letter, name in names.items()})


_MAKERS: Final[Mapping[str, Callable[[Axes, Clock, Publish], Stage]]] = {
    "zaber": _zaber,
    "ximc": partial(_on_own_ports, XimcController),
    "grbl": _grbl,
    "esp301": _esp301,
    "flir_ptu": _flir_ptu,
    "thorlabs_apt": partial(_on_own_ports, AptController, notices_stalls=False),
}


def make_light(
    config: LightConfig, clock: Callable[[], float], drive: Callable[[LightState], None]
) -> LightDriver:
    """Build the driver of a light, as another program left it."""
    light = _light_driver(config, clock, drive)
    for what in config.left_behind.split():
        light.leave(what)
    return light


def _light_driver(
    config: LightConfig, clock: Callable[[], float], drive: Callable[[LightState], None]
) -> LightDriver:
    if config.kind == "gardasoft":
        return GardasoftRt(clock, drive)
    if config.kind == "microcontroller":
        return MicrocontrollerLight(config.serial, clock, drive)
    if config.kind == "siglent":
        return SiglentGenerator(config.serial, clock, drive)
    if config.kind == "rigol":
        model = GeneratorModel(
            config.serial,
            "Rigol Technologies",
            "DG4062",
            "00.01.12",
            config.error_queue,
            numbered_channels=True,
            modulations=("MOD", "AM", "FM", "PM", "ASK", "FSKey", "PSK", "PWM", "SWEep", "BURSt"),
        )
    else:
        model = GeneratorModel(config.serial, error_queue=config.error_queue)
    return ScpiGenerator(model, clock, drive)
