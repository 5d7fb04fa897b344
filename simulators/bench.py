"""The simulated bench: every device of a station, answering on its own port, in a process of its own.

    python -m simulators.bench --folder DIR [--config FILE.json] [--seed N] [--until-eof]

prints one line of JSON once all devices answer: the ports, where the truth is written, and its process id.
Then it lives until it is told to end (SIGTERM, SIGINT, or the end of standard input with ``--until-eof``),
and takes its ports away. The truth is for the final comparison, and for nobody who estimates.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from simulators.axis_motion import Mechanics
from simulators.config import AxisConfig, BenchConfig, bench_config
from simulators.errors import ConfigError, SimulatorError
from simulators.evk4 import SimulatedEvk4
from simulators.pseudo_terminal import PseudoTerminal
from simulators.scpi_generator import GeneratorModel, ScpiGenerator
from simulators.sensor_stream import CameraState, SensorStream
from simulators.serial_device import SerialDevice
from simulators.trajectory import Pointing
from simulators.truth import Truth
from simulators.world import AxisMotion, AxisName, LightState, World
from simulators.zaber import ZaberChain
from simulators.zaber_controller import ZaberController, ZaberModel

#: End stops lie this much beyond the soft limits.
_STOP_MARGIN_DEG = 2.0


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
        self.world = World(self._config.truth, seed=seed, camera_seed=self._config.camera_seed)
        self._running = ExitStack()
        self.truth_path = folder / "truth.json"
        self.endpoints: dict[str, str] = {}

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self.gimbal = stack.enter_context(self._serial("gimbal", self._chain()))
            self.light = stack.enter_context(self._serial("light", self._generator()))
            self.camera = SimulatedEvk4(self.world, serial=self._config.camera_serial)
            self.camera.start()
            stack.callback(self.camera.close)
            self._write_truth()
            self._running = stack.pop_all()
        self.endpoints = {
            "gimbal": self.gimbal.address,
            "light": self.light.address,
            "camera": self.camera.address,
        }
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._running.close()

    # ------------------------------------------------------------------ inside
    def _serial(self, name: str, dialect: ZaberChain | ScpiGenerator) -> SerialDevice:
        return SerialDevice(PseudoTerminal(self._folder / name), dialect, paced=self._config.paced)

    def _chain(self) -> ZaberChain:
        now = self.world.now_s()
        controllers = [
            ZaberController(_zaber_model(axis), now, partial(self._axis_moves, name))
            for name, axis in self._config.axes.items()
        ]
        return ZaberChain(controllers, self.world.now_s)

    def _axis_moves(self, name: AxisName, pointing: Pointing) -> None:
        motion = AxisMotion(pointing.angle_deg, pointing.settled_from_s, round(pointing.rest))
        self.world.set_axis(name, motion, since_s=pointing.course.start_s)

    def _generator(self) -> ScpiGenerator:
        light = self._config.light
        model = GeneratorModel(serial=light.serial, error_queue=light.error_queue)
        return ScpiGenerator(model, self.world.now_s, self.world.set_light)

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


def _zaber_model(axis: AxisConfig) -> ZaberModel:
    steps = axis.microsteps_per_deg
    stop_deg = axis.limit_deg + _STOP_MARGIN_DEG
    return ZaberModel(
        mechanics=Mechanics(
            counts_per_deg=float(steps),
            lowest_deg=-stop_deg,
            highest_deg=stop_deg,
            start_deg=axis.start_deg,
            settle_s=axis.settle_s,
            backlash_deg=axis.backlash_deg,
        ),
        serial=axis.serial,
        lowest=-round(axis.limit_deg * steps),
        highest=round(axis.limit_deg * steps),
        speed_deg_s=axis.speed_deg_s,
        acceleration_deg_s2=axis.acceleration_deg_s2,
        encoder=axis.encoder,
    )


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


def _ending(until_eof: bool) -> Callable[[], object]:
    """Give a call that returns when the process shall end."""
    ending = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda _number, _frame: ending.set())
    if until_eof:

        def watch() -> None:
            # Not sys.stdin: its lock would be held by this thread while the interpreter shuts down.
            while os.read(sys.stdin.fileno(), 4096):
                pass
            ending.set()

        threading.Thread(target=watch, name="standard input", daemon=True).start()
    return ending.wait


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
    wait = _ending(arguments.until_eof)
    try:
        arguments.folder.mkdir(parents=True, exist_ok=True)
        with Bench(arguments.folder, _read_config(arguments.config), arguments.seed) as bench:
            ready = {"endpoints": bench.endpoints, "truth": str(bench.truth_path), "pid": os.getpid()}
            print(json.dumps(ready), flush=True)
            threading.Thread(target=_warm_up, args=(bench.world.truth,), name="warm-up", daemon=True).start()
            wait()
    except (SimulatorError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    status = main()
    # The warm-up may still be compiling; everything else has ended, and a compiler cannot be interrupted.
    os._exit(status)
