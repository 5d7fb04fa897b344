"""The simulated bench: all devices of a station in one process, each on its own port.

    python -m simulators.bench --folder DIR [--config FILE.json] [--seed N] [--until-eof]

When all devices answer, the program prints one line of JSON: the ports, the path of the truth file, and its
process id. It runs until SIGTERM or SIGINT arrives, or, with ``--until-eof``, until standard input ends; then it
removes its ports. Each line on standard input is an order for a fault (see `faults`), answered by a line of JSON.
The truth file is for the final comparison only; no estimate may use it.

While it runs, a file tells how much time the process could use, so that another program can tell a busy computer from
a fault: its first 8 bytes are that time as a little-endian double, in seconds (`Pulse`).
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import mmap
import os
import struct
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np

from simulators.assembly import make_light, make_stage
from simulators.cameras.evk4 import SimulatedEvk4
from simulators.cameras.frame_camera import SimulatedFrameCamera
from simulators.config import BenchConfig, bench_config
from simulators.errors import ConfigError, SimulatorError
from simulators.faults.camera_hands import HAND_DEVICES, CameraHands
from simulators.faults.catalogue import (
    FaultOrder,
    fault_order,
    fault_order_from_text,
    print_answer,
    take_orders,
    told_to_stop,
)
from simulators.faults.fault_injection import BenchParts, fault_action
from simulators.faults.line_faults import FaultLine
from simulators.lights.lamp import Lamp
from simulators.optics.lens_focus import truth_record
from simulators.ports.serial_device import Dialect, SerialDevice, TcpPort
from simulators.warm_up import warm_up
from simulators.world.trajectory import LoadTrajectory
from simulators.world.world import AxisMotion, AxisName, World, with_setup

PERIOD_S = 0.02
"""The thread asks to be woken after this time, s."""
_NEW_OBJECTS: Final = 200_000
"""Python looks for cycles after so many new objects. Compiling makes millions, and a search takes longer each time."""


class Pulse:
    """The time that this process could use, in a file."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(bytes(8))
        with path.open("r+b") as file:
            self._shared = mmap.mmap(file.fileno(), 8)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="pulse", daemon=True)
        self._thread.start()

    def _beat(self) -> None:
        lived_s, last_s = 0.0, time.monotonic()
        while not self._ended.wait(PERIOD_S):
            now_s = time.monotonic()
            lived_s += min(now_s - last_s, 2.0 * PERIOD_S)
            last_s = now_s
            struct.pack_into("<d", self._shared, 0, lived_s)

    def close(self) -> None:
        """End the thread; the file remains."""
        self._ended.set()
        self._thread.join()
        with suppress(BufferError):
            self._shared.close()


class Bench:
    """A gimbal, a light and two cameras in one world; they answer inside a ``with`` block. ``hands`` are a person's."""

    def __init__(self, folder: Path, config: BenchConfig | None = None, seed: int = 1) -> None:
        self._folder = folder
        self._config = config if config is not None else BenchConfig()
        own_seed = self._config.camera_seed
        self.world = World(
            self._config.truth_for(seed), seed=seed, camera_seed=seed if own_seed is None else own_seed
        )
        self._running = ExitStack()
        self.truth_path = folder / "truth.json"
        self._truth_lock = threading.Lock()
        self.hands = CameraHands(self.world, self._write_truth)
        self.endpoints: dict[str, str] = {}

    def __enter__(self) -> Self:
        clock = self.world.now_s
        lamp = Lamp(self.world.set_light)
        light = make_light(self._config.light, clock, lamp.drive)
        stage = make_stage(self._config.stage_kind, self._config.axes, clock, self._publish_axis)
        for message in self._config.stage_left_behind:
            for dialect in stage.dialects.values():
                dialect.receive(message)
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
                stage.controllers,
                ports,
                lines,
                stage.ports,
                light,
                lamp,
                camera,
                clock,
                frame_camera,
                self.hands,
            )
            self.endpoints = {name: port.address for name, port in ports.items()}
            self.endpoints |= {"camera": camera.address, "frame-camera": frame_camera.address}
            self._running = stack.pop_all()
        for order in self._config.faults:
            self.inject(order)
        return self

    def inject(self, order: FaultOrder) -> None:
        """Inject a fault, at once or after the order's delay."""
        action = fault_action(order, self._bench_parts)
        if order.after_s <= 0.0:
            action()
            return
        timer = threading.Timer(order.after_s, action)
        timer.daemon = True
        self._running.callback(timer.cancel)
        timer.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._running.close()

    # ------------------------------------------------------------------ inside
    def _serial(self, name: str, dialect: Dialect) -> SerialDevice:
        if self._config.ports == "tcp":
            idle_s = self._config.light.idle_s if name == "light" else 0.0
            port = TcpPort(name, idle_s=idle_s, clock=self.world.now_s)
            return SerialDevice(port, dialect, paced=self._config.paced)
        from simulators.ports.pseudo_terminal import PseudoTerminal  # some platforms have none

        return SerialDevice(PseudoTerminal(self._folder / name), dialect, paced=self._config.paced)

    def _publish_axis(self, name: AxisName, pointing: LoadTrajectory) -> None:
        motion = AxisMotion(pointing.angle_deg, pointing.settled_from_s, round(pointing.rest))
        self.world.set_axis(name, motion, since_s=pointing.motor.start_s)

    def _write_truth(self) -> None:
        fresh = self.truth_path.with_suffix(".part")
        try:
            with self._truth_lock:
                truth = with_setup(self.world.truth, self.world.camera_setup(self.world.now_s()))
                fresh.write_text(json.dumps(truth_record(truth), indent=1), encoding="utf-8")
                fresh.replace(self.truth_path)
        except OSError as error:
            raise SimulatorError(
                f"Cannot write the truth file: {error.strerror}.",
                where=str(self.truth_path),
                remedy="Choose a folder with write permission.",
            ) from error


def _read_config(path: Path | None) -> BenchConfig:
    """Read the configuration file."""
    if path is None:
        return BenchConfig()
    try:
        given: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(
            f"Cannot read the file: {error.strerror}.",
            where=str(path),
            remedy="Check the path given with --config.",
        ) from error
    except ValueError as error:
        raise ConfigError(
            f"The file is not JSON: {error}.", where=str(path), remedy="Correct the file at that place."
        ) from error
    if not isinstance(given, dict):
        raise ConfigError(
            "Expected a JSON object of sections.",
            where=str(path),
            remedy='Begin with a section, as in: {"stage": {}}',
        )
    return bench_config(given)


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="simulators.bench", description="A simulated calibration bench.")
    parser.add_argument("--folder", type=Path, required=True, help="folder for the ports and the truth file")
    parser.add_argument("--config", type=Path, help="configuration file (JSON)")
    parser.add_argument("--seed", type=int, default=1, help="seed of all randomness")
    parser.add_argument("--until-eof", action="store_true", help="stop when standard input ends")
    return parser.parse_args(words)


def _execute(bench: Bench, line: str) -> dict[str, Any]:
    """Carry out an order, written as JSON or as text, and return what was done."""
    order = fault_order(json.loads(line)) if line.startswith("{") else fault_order_from_text(line)
    bench.inject(order)
    done: dict[str, Any] = {
        "device": order.device,
        "fault": order.fault,
        "after_s": order.after_s,
        **order.parameters,
    }
    if order.device in HAND_DEVICES:
        done["now"] = bench.hands.seen()
    return {key: "infinity" if value in (math.inf, -math.inf) else value for key, value in done.items()}


def main(words: Sequence[str] | None = None) -> int:
    """Run the bench until it is told to stop; return 0, or 2 if it cannot start: standard error has the reason."""
    arguments = _arguments(words)
    ending = told_to_stop()
    gc.set_threshold(_NEW_OBJECTS)
    try:
        arguments.folder.mkdir(parents=True, exist_ok=True)
        with Bench(arguments.folder, _read_config(arguments.config), arguments.seed) as bench:
            ready = {"endpoints": bench.endpoints, "truth": str(bench.truth_path), "pid": os.getpid()}
            pulse_path = arguments.folder / "pulse"
            pulse = Pulse(pulse_path)
            ready["pulse"] = str(pulse_path)
            print_answer(ready)
            threading.Thread(target=warm_up, args=(bench.world.truth,), name="warm-up", daemon=True).start()
            ended = ending.set if arguments.until_eof else lambda: None
            threading.Thread(target=take_orders, args=(partial(_execute, bench), ended), daemon=True).start()
            ending.wait()
            pulse.close()
    except (SimulatorError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    status = main()
    # Exit at once: the warm-up may still be compiling and cannot be interrupted; everything else has ended.
    os._exit(status)
