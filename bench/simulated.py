"""The simulated bench in place of the station's devices. Beside it, only the tests for plug-ins import the simulators.

The simulators run in a process of their own, on pseudo-terminals and a socket, so that drivers work as with real
devices; it ends when its input closes, with this one. The truth is read once, after the calibration.
"""

from __future__ import annotations

import json
import mmap
import queue
import struct
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from bench.base.errors import SimulationError
from drivers.lateness import BUSY_S, Deadline, busy_text, follow_clock, follow_no_clock
from drivers.lateness import REMEDY as BUSY_REMEDY

if TYPE_CHECKING:
    from simulators.rehearsed_world import RehearsedWorld as RehearsedWorld  # noqa: PLC0414 - exported, as a type

_START_TIMEOUT_S = 120.0
"""The very first start compiles the pixel model; later starts take about a second."""


class SimulatedBench:
    """A simulated bench in a process of its own; ``endpoints`` are ports by device, ``sim:light`` that of ``light``."""

    def __init__(self, config: Mapping[str, Any], seed: int) -> None:
        self._ordering = threading.Lock()
        self.endpoints: dict[str, str] = {}
        self._folder = tempfile.TemporaryDirectory(prefix="starbench-")
        folder = Path(self._folder.name)
        config_path = folder / "config.json"
        config_path.write_text(json.dumps(dict(config)), encoding="utf-8")
        self._log = (folder / "log.txt").open("w+", encoding="utf-8")
        command = [
            sys.executable,
            "-m",
            "simulators.bench",
            "--folder",
            str(folder),
            "--config",
            str(config_path),
        ]
        command += ["--seed", str(seed), "--until-eof"]
        # A session of its own: Ctrl-C at the terminal must reach the run alone, which then makes the devices safe.
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            start_new_session=True,
        )
        starting = Deadline(_START_TIMEOUT_S)
        try:
            ready = json.loads(self._first_line())
            self.endpoints = dict(ready["endpoints"])
            self._truth_path = Path(ready["truth"])
            self._follow_its_clock(Path(ready["pulse"]))
        except (json.JSONDecodeError, KeyError, SimulationError) as error:
            last_line = self._last_log_line()
            self.close()
            busy = not last_line and starting.late_s() > BUSY_S
            why = busy_text(starting.late_s()) if busy else last_line or error
            raise SimulationError(
                f"The simulated bench did not start: {why}",
                remedy=BUSY_REMEDY if busy else "Check the simulation section of the station file.",
            ) from error

    def _follow_its_clock(self, path: Path) -> None:
        """Let the deadlines of the devices follow the time that the process of the simulated bench could use."""
        with path.open("rb") as file:
            shared = mmap.mmap(file.fileno(), 8, access=mmap.ACCESS_READ)

        def lived_s() -> float:
            return float(struct.unpack_from("<d", shared)[0])

        for address in self.endpoints.values():
            follow_clock(address, lived_s)

    def _first_line(self) -> str:
        stdout = self.process.stdout
        assert stdout is not None
        lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        # A thread waits, because not every system can wait for a pipe with a time limit.
        threading.Thread(target=lambda: lines.put(stdout.readline()), daemon=True).start()
        starting = Deadline(_START_TIMEOUT_S)
        while (left_s := starting.left_s()) > 0:
            with suppress(queue.Empty):
                return lines.get(timeout=left_s)
        raise SimulationError(f"it was not ready within {_START_TIMEOUT_S:.0f} s")

    def _last_log_line(self) -> str:
        try:
            self.process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            return ""
        self._log.flush()
        self._log.seek(0)
        lines = self._log.read().strip().splitlines()
        return lines[-1] if lines else ""

    @property
    def alive(self) -> bool:
        """Whether the process still runs."""
        return self.process.poll() is None

    def order(self, line: str) -> str:
        """Order a fault of a simulated device (docs/simulated-bench.md), as words or as JSON."""
        stdin, stdout = self.process.stdin, self.process.stdout
        assert stdin is not None
        assert stdout is not None
        with self._ordering:  # an answer belongs to the order before it
            try:
                stdin.write(line.rstrip("\n") + "\n")
                stdin.flush()
            except (BrokenPipeError, ValueError) as error:  # ValueError: it was closed
                raise SimulationError("The simulated bench has ended by itself.") from error
            return stdout.readline().rstrip("\n")

    def truth(self) -> dict[str, Any]:
        """Read the true parameters of the simulated bench, for the final comparison. No estimator may use them."""
        truth: dict[str, Any] = json.loads(self._truth_path.read_text(encoding="utf-8"))
        return truth

    def close(self) -> None:
        """End the process and remove its files and ports."""
        for address in self.endpoints.values():
            follow_no_clock(address)
        if self.process.stdin is not None:
            self.process.stdin.close()
        try:
            self.process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
        self._log.close()
        self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def fault_of_simulation(config: Mapping[str, Any], axes: Iterable[str]) -> tuple[str, str] | None:
    """Return the key and what is wrong with it, if the simulated bench cannot be made, or lacks an axis; else None.

    ``axes`` are those that the station asks of the simulated stage.
    """
    from simulators.config import bench_config
    from simulators.errors import ConfigError

    try:
        simulated = bench_config(config).axes
    except ConfigError as error:
        return error.where, f"{error.what} {error.remedy}".strip()
    for axis in axes:
        if axis not in simulated:
            return "stage", f"The simulated stage has no axis {axis}. Name it here: {axis}: {{}}."
    return None


def make_rehearsed_world(config: Mapping[str, Any], seed: int) -> RehearsedWorld:
    """Make a simulated world for a rehearsal: without a process, ports or devices."""
    from simulators.errors import ConfigError
    from simulators.rehearsed_world import RehearsedWorld

    try:
        return RehearsedWorld(config, seed)
    except ConfigError as error:
        raise SimulationError(
            f"{error.what} {error.remedy}".strip(), where=f"simulation.{error.where}"
        ) from error
