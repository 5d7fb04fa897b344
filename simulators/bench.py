"""The simulated bench: every device of a station, answering on its own port, in a process of its own.

    python -m simulators.bench --folder DIR [--config FILE.json] [--seed N] [--until-eof]

prints one line of JSON once all devices answer: the ports, where the truth is written, and its process id.
Then it lives until it is told to end (SIGTERM, SIGINT, or the end of standard input with ``--until-eof``), and
takes its ports away. Each line on standard input is an order for a fault (see `faults`), answered by a line of JSON.
The truth is for the final comparison, and for nobody who estimates.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from simulators.assembly.lights import make_light
from simulators.assembly.stages import make_stage
from simulators.cameras.evk4 import SimulatedEvk4
from simulators.cameras.frame_camera import SimulatedFrameCamera
from simulators.config import BenchConfig, bench_config
from simulators.errors import ConfigError, SimulatorError
from simulators.faults.catalogue import FaultOrder, fault_order, fault_order_from_text
from simulators.faults.fault_injection import BenchParts, fault_action
from simulators.faults.line_faults import FaultLine
from simulators.faults.orders import allow_background, answer, take_orders
from simulators.lights.lamp import Lamp
from simulators.pixels.sensor_stream import CameraState, SensorStream
from simulators.ports.serial_device import Dialect, Port, SerialDevice
from simulators.ports.tcp_port import TcpPort
from simulators.world.trajectory import Pointing
from simulators.world.truth import Truth
from simulators.world.world import AxisMotion, AxisName, LightState, World


class Bench:
    """A gimbal, a light and a camera in one world; entering it makes them answer.

    Parameters
    ----------
    folder
        Where the ports' links and the truth are put.
    config
        Which devices, in which world.
    seed
        Seed of everything random over time.

    Raises
    ------
    SimulatorError
        When a port or the truth cannot be written.
    """

    def __init__(self, folder: Path, config: BenchConfig | None = None, seed: int = 1) -> None:
        self._folder = folder
        self._config = config if config is not None else BenchConfig()
        own_seed = self._config.camera_seed
        self.world = World(
            self._config.truth_for(seed), seed=seed, camera_seed=seed if own_seed is None else own_seed
        )
        self._running = ExitStack()
        self.truth_path = folder / "truth.json"
        self.endpoints: dict[str, str] = {}

    def __enter__(self) -> Self:
        clock = self.world.now_s
        lamp = Lamp(self.world.set_light)
        light = make_light(self._config.light, clock, lamp.drive)
        stage = make_stage(self._config.stage_kind, self._config.axes, clock, self._publish_axis)
        dialects: dict[str, Dialect] = {**stage.dialects, "light": light}
        chance = np.random.SeedSequence(self.world.seed).spawn(len(dialects))
        lines = {
            name: FaultLine(dialect, clock, np.random.default_rng(seed))
            for (name, dialect), seed in zip(dialects.items(), chance, strict=True)
        }
        with ExitStack() as stack:
            ports = {name: stack.enter_context(self._serial(name, line)) for name, line in lines.items()}
            camera = SimulatedEvk4(self.world, serial=self._config.camera_serial)
            camera.start()
            stack.callback(camera.close)
            frame_camera = SimulatedFrameCamera(self.world)
            frame_camera.start()
            stack.callback(frame_camera.close)
            self._write_truth()
            self._bench_parts = BenchParts(
                stage.controllers, ports, lines, stage.ports, light, lamp, camera, clock, frame_camera
            )
            self.endpoints = {name: port.address for name, port in ports.items()}
            self.endpoints |= {"camera": camera.address, "frame-camera": frame_camera.address}
            self._running = stack.pop_all()
        for one in self._config.faults:
            self.inject(one)
        return self

    def inject(self, one: FaultOrder) -> None:
        """Let something go wrong, at once or after the order's time.

        Raises
        ------
        ConfigError
            When this bench has no such device, or a parameter makes no sense.
        """
        bring_about = fault_action(one, self._bench_parts)
        if one.after_s <= 0.0:
            bring_about()
            return
        timer = threading.Timer(one.after_s, bring_about)
        timer.daemon = True
        self._running.callback(timer.cancel)
        timer.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._running.close()

    # ------------------------------------------------------------------ inside
    def _serial(self, name: str, dialect: Dialect) -> SerialDevice:
        port: Port
        if self._config.ports == "tcp":
            port = TcpPort(name)
        else:
            from simulators.ports.pseudo_terminal import PseudoTerminal  # not where there are none

            port = PseudoTerminal(self._folder / name)
        return SerialDevice(port, dialect, paced=self._config.paced)

    def _publish_axis(self, name: AxisName, pointing: Pointing) -> None:
        motion = AxisMotion(pointing.angle_deg, pointing.settled_from_s, round(pointing.rest))
        self.world.set_axis(name, motion, since_s=pointing.course.start_s)

    def _write_truth(self) -> None:
        fresh = self.truth_path.with_suffix(".part")
        try:
            fresh.write_text(json.dumps(self.world.truth.to_dict(), indent=1), encoding="utf-8")
            fresh.replace(self.truth_path)
        except OSError as error:
            raise SimulatorError(
                f"The truth cannot be written: {error.strerror}.",
                where=str(self.truth_path),
                remedy="Choose a folder that can be written to.",
            ) from error


def _warm_up(truth: Truth) -> None:
    """Have the pixel model's machine code loaded, or compiled, before the first recording asks for it."""
    world = World(truth)
    world.set_light(LightState(output=True, sync=True))
    SensorStream(world, CameraState(trigger_in=True), {}).next_frame()


def _read_config(path: Path | None) -> BenchConfig:
    """Read the configuration's file."""
    if path is None:
        return BenchConfig()
    try:
        given: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"It cannot be read: {error.strerror}.", where=str(path)) from error
    except ValueError as error:
        raise ConfigError(f"It is not JSON: {error}.", where=str(path)) from error
    if not isinstance(given, dict):
        raise ConfigError("A mapping of sections is expected.", where=str(path))
    return bench_config(given)


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="simulators.bench", description="A simulated calibration bench.")
    parser.add_argument("--folder", type=Path, required=True, help="where the ports and the truth are put")
    parser.add_argument("--config", type=Path, help="configuration (JSON)")
    parser.add_argument("--seed", type=int, default=1, help="seed of everything random")
    parser.add_argument("--until-eof", action="store_true", help="end with standard input")
    return parser.parse_args(words)


def _execute(bench: Bench, line: str) -> dict[str, Any]:
    """Carry out an order, written as JSON or as words, and say what was done."""
    one = fault_order(json.loads(line)) if line.startswith("{") else fault_order_from_text(line)
    bench.inject(one)
    return {"device": one.device, "fault": one.fault, "after_s": one.after_s, **one.parameters}


def main(words: Sequence[str] | None = None) -> int:
    """Run the bench until it is told to end.

    Parameters
    ----------
    words
        Command line, `sys.argv` if None.

    Returns
    -------
    int
        Exit status: 0, or 2 when it cannot start, with one line on standard error that says why.
    """
    arguments = _arguments(words)
    ending = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda _number, _frame: ending.set())
    allow_background()
    try:
        arguments.folder.mkdir(parents=True, exist_ok=True)
        with Bench(arguments.folder, _read_config(arguments.config), arguments.seed) as bench:
            ready = {"endpoints": bench.endpoints, "truth": str(bench.truth_path), "pid": os.getpid()}
            answer(ready)
            threading.Thread(target=_warm_up, args=(bench.world.truth,), name="warm-up", daemon=True).start()
            ended = ending.set if arguments.until_eof else lambda: None
            threading.Thread(target=take_orders, args=(partial(_execute, bench), ended), daemon=True).start()
            ending.wait()
    except (SimulatorError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    status = main()
    # The warm-up may still be compiling; everything else has ended, and a compiler cannot be interrupted.
    os._exit(status)
