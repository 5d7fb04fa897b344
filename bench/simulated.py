"""The simulated bench in place of the station's devices. No other module of the bench imports the simulators.

The simulators run in a process of their own and answer on pseudo-terminals and a socket, so that the drivers work as
with real devices. That process ends with this one, in whatever way this one ends: its standard input is then closed.
Its true parameters are read once, after the calibration, for the final comparison only.
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
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from bench.base.errors import SimulationError
from drivers.lateness import BUSY_S, Deadline, busy_text, follow_clock, follow_no_clock
from drivers.lateness import REMEDY as BUSY_REMEDY

if TYPE_CHECKING:
    from simulators.rehearsed_world import RehearsedWorld as RehearsedWorld  # noqa: PLC0414 - exported, as a type
    from simulators.virtual_capture import VirtualCamera

# Lens and mount of the simulated camera, as the hands of a person would set them. Imports no simulator.


@dataclass(frozen=True)
class LensAndMount:
    """What can be read from the simulated camera's lens and mount."""

    # Distance on the scale of the focus ring; infinite for parallel light, negative beyond infinity.
    focus_distance_m: float
    # Angle of the focus ring: 0 at infinity, 180 at the near stop, negative beyond infinity.
    ring_deg: float
    f_number: float
    turn_deg: tuple[float, float, float]
    # How far the camera was moved across the beam, along the target's X and Y.
    shift_mm: tuple[float, float]


class SimulatedHands:
    """Hands of a person at the lens and the mount of the simulated camera. A real bench has none.

    Each method returns what lens and mount show afterwards. It raises `SimulationError` if the simulated bench has
    ended or refuses: for example, the focus ring does not reach that distance. The image changes at once, also during a
    recording.

    order: Sends an order to the simulated bench and returns its answer: `SimulatedBench.order`.
    """

    def __init__(self, order: Callable[[str], str]) -> None:
        self._order = order

    def look(self) -> LensAndMount:
        """Read lens and mount without a change."""
        return self._do("lens", "turn", deg=0.0)

    def turn_focus(self, by_deg: float) -> LensAndMount:
        """Turn the focus ring, at most to its stop.

        by_deg: Angle; positive: focus nearer.
        """
        return self._do("lens", "turn", deg=by_deg)

    def set_focus_ring(self, to_deg: float) -> LensAndMount:
        """Turn the focus ring to an angle, at most to its stop."""
        return self._do("lens", "ring", deg=to_deg)

    def focus_at(self, distance_m: float) -> LensAndMount:
        """Turn the focus ring until a distance is in focus.

        distance_m: The distance; ``math.inf`` for infinity.
        """
        return self._do("lens", "focus", distance_m=distance_m)

    def set_aperture(self, f_number: float) -> LensAndMount:
        """Set the aperture."""
        return self._do("lens", "aperture", f_number=f_number)

    def turn_camera(
        self, *, pan_deg: float = 0.0, tilt_deg: float = 0.0, roll_deg: float = 0.0
    ) -> LensAndMount:
        """Loosen the camera in its mount and turn it, from how it stands."""
        return self._do("mount", "turn", pan_deg=pan_deg, tilt_deg=tilt_deg, roll_deg=roll_deg)

    def shift_camera(self, x_mm: float, y_mm: float) -> LensAndMount:
        """Move the camera across the beam, to a distance from where it was aligned.

        x_mm, y_mm: Distance along the target's X and Y.
        """
        return self._do("mount", "shift", x_mm=x_mm, y_mm=y_mm)

    def place_board(self, number: int) -> LensAndMount:
        """Put the board of the simulated bench at a placement of its script.

        number: Number of the placement, from 1; the same number always gives the same place.
        """
        return self._do("board", "place", number=number)

    def put_back(self) -> LensAndMount:
        """Put lens and mount back to how they stood when the simulated bench started."""
        self._do("mount", "mend")
        return self._do("lens", "mend")

    def _do(self, device: str, what: str, **parameters: float) -> LensAndMount:
        """Send an order, and read the answer."""
        text = self._order(json.dumps({"device": device, "fault": what, **parameters}))
        try:
            answer = json.loads(text)
        except json.JSONDecodeError as error:
            raise SimulationError("The simulated bench has ended by itself.") from error
        if not answer["ok"]:
            raise SimulationError(str(answer["error"]))
        now = answer["now"]
        (pan, tilt, roll), (x, y) = now["turn_deg"], now["shift_mm"]
        focus_m = float(now["focus_distance_m"])
        return LensAndMount(focus_m, now["ring_deg"], now["f_number"], (pan, tilt, roll), (x, y))


_START_TIMEOUT_S = 120.0
"""The very first start compiles the pixel model; later starts take about a second."""


class SimulatedBench:
    """A simulated bench in a process of its own, which the constructor starts.

    config: The station file's ``simulation`` section.
    endpoints: Ports by name of the device; a station file calls the port of ``light`` ``sim:light``.
    Raises SimulationError: When it does not start; the message has the last line of its log.
    """

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
        self._process = subprocess.Popen(
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
        stdout = self._process.stdout
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
            self._process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            return ""
        self._log.flush()
        self._log.seek(0)
        lines = self._log.read().strip().splitlines()
        return lines[-1] if lines else ""

    @property
    def alive(self) -> bool:
        """Whether the process still runs."""
        return self._process.poll() is None

    def order(self, line: str) -> str:
        """Order a fault of a simulated device (docs/simulated-bench.md).

        line: The order, as words or as JSON.
        Raises SimulationError: When the process has ended.
        """
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        with self._ordering:  # an answer belongs to the order before it
            try:
                stdin.write(line.rstrip("\n") + "\n")
                stdin.flush()
            except (BrokenPipeError, ValueError) as error:  # ValueError: it was closed
                raise SimulationError("The simulated bench has ended by itself.") from error
            return stdout.readline().rstrip("\n")

    @property
    def hands(self) -> SimulatedHands:
        """Hands at the lens and the mount of the simulated camera."""
        return SimulatedHands(self.order)

    def truth(self) -> dict[str, Any]:
        """Read the true parameters of the simulated bench, for the final comparison. No estimator may use them."""
        truth: dict[str, Any] = json.loads(self._truth_path.read_text(encoding="utf-8"))
        return truth

    def close(self) -> None:
        """End the process and remove its files and ports."""
        for address in self.endpoints.values():
            follow_no_clock(address)
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._log.close()
        self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def make_rehearsed_world(config: Mapping[str, Any], seed: int) -> RehearsedWorld:
    """Make a simulated world for a rehearsal: without a process, ports or devices.

    config: The station file's ``simulation`` section.
    Raises SimulationError: When the configuration is not valid.
    """
    from simulators.errors import ConfigError
    from simulators.rehearsed_world import RehearsedWorld

    try:
        return RehearsedWorld(config, seed)
    except ConfigError as error:
        raise SimulationError(
            f"{error.what} {error.remedy}".strip(), where=f"simulation.{error.where}"
        ) from error


def virtual_camera(section: Mapping[str, Any], seed: int) -> VirtualCamera:
    """Make a simulated camera that records at once, in this process and without devices.

    section: As the ``simulation`` section of a station file.
    Raises SimulationError: If the section is not valid.
    """
    from simulators.errors import ConfigError
    from simulators.virtual_capture import VirtualCamera

    try:
        return VirtualCamera(section, seed)
    except ConfigError as error:
        raise SimulationError(str(error), remedy="Correct the specification.") from error
