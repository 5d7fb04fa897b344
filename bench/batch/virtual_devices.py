"""Virtual devices for rehearsals on a virtual clock; they follow the same protocols as real drivers.

A move takes distance over speed, a recording its duration. A rehearsed world (`bench.simulated`) gives star centres,
not events; a recording is a small text file that says so. No process, port or thread.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.base.bounded_json import parse_json
from bench.base.clock import BenchClock
from bench.measure.gates import FILTERS_TO_DISABLE
from bench.plan.plan import HOMING_EXTRA_S, LIGHT_OFF_S, LIGHT_ON_S, MOVE_EXTRA_S, RECORD_EXTRA_S
from bench.record.storage import read_bounded
from bench.simulated import make_rehearsed_world
from bench.stations.devices import Devices
from bench.stations.sections import FrameCameraSection
from bench.stations.station import Station
from calib.target import StarTarget
from calib.view import View
from drivers.camera import CameraIdentity, CameraSettings, RecordingFacts
from drivers.errors import NotHomed, RecordingFailed, WrongDevice
from drivers.light import LightIdentity, LightSettings
from drivers.stage import AxisIdentity, AxisLimits
from drivers.stage.motion import check_targets, longest_move_s, whole_range_s

if TYPE_CHECKING:
    from bench.simulated import RehearsedWorld

MAKER = "Starbench"
MODEL = "virtual, for rehearsals"
FIRST_LINE = b"% REHEARSAL: stars as a rehearsed world gave them; no camera and no events\n"


class VirtualDevices(Devices):
    """A station's virtual stage, light and camera; a station of real devices is rehearsed by ``expected``."""

    def __init__(self, station: Station, *, seed: int, clock: BenchClock) -> None:
        self.simulation = None
        self._clock = clock
        self._world = make_rehearsed_world(_configuration(station), seed)
        self.stage = VirtualStage({name: axis.limits for name, axis in station.axes.items()}, clock)
        self.light = VirtualLight(clock)
        simulated = station.needs_simulated_bench and not isinstance(station.camera, FrameCameraSection)
        serial = self._world.bench.camera_serial if simulated else station.camera.serial
        if serial != station.camera.serial:
            raise WrongDevice(
                f"The station file names serial number {station.camera.serial}, but the camera has {serial}.",
                where="camera",
                remedy="Connect the camera that the station file names.",
            )
        self.camera = VirtualCamera(serial, self._world, self.stage, self.light, clock)
        self._opened = ExitStack()

    def truth(self) -> dict[str, Any]:
        """See `Devices.truth`. The rehearsed world at this time."""
        return self._world.truth_record(self._clock.monotonic())


class VirtualStage:
    """Axes that reach their target after the time of the move; a ``drivers.stage.Stage``."""

    def __init__(self, limits: Mapping[str, AxisLimits], clock: BenchClock) -> None:
        self.limits = limits
        self._clock = clock
        self.at_deg: dict[str, float] | None = None  # None without a reference

    @property
    def axes(self) -> Sequence[str]:
        """Names of the axes."""
        return tuple(self.limits)

    def identify(self) -> Sequence[AxisIdentity]:
        """See `Stage.identify`."""
        return [AxisIdentity(name, MAKER, MODEL, "none", "") for name in self.limits]

    def is_homed(self) -> bool:
        """See `Stage.is_homed`."""
        return self.at_deg is not None

    def home(self) -> None:
        """See `Stage.home`. Takes the time of a move over the whole range."""
        self._clock.sleep(whole_range_s(self.limits) + HOMING_EXTRA_S)
        self.at_deg = dict.fromkeys(self.limits, 0.0)

    def move_to(self, target_deg: Mapping[str, float]) -> None:
        """Move the axes to angles in degrees; takes the time of a real move."""
        at_deg = self.position_deg()
        check_targets(self.limits, target_deg, "stage")
        self._clock.sleep(self.move_duration_s(at_deg, target_deg) + MOVE_EXTRA_S)
        self.at_deg = {**at_deg, **target_deg}

    def move_duration_s(self, from_deg: Mapping[str, float], to_deg: Mapping[str, float]) -> float:
        """See `Stage.move_duration_s`. The time of the slowest axis."""
        return longest_move_s(self.limits, from_deg, to_deg)

    def position_deg(self) -> dict[str, float]:
        """Return the angle by axis, degrees. Raises NotHomed if the stage is not homed."""
        if self.at_deg is None:
            raise NotHomed("The virtual stage is not homed.", where="stage", remedy="Home it first.")
        return dict(self.at_deg)

    def encoder_deg(self) -> Mapping[str, float]:
        """See `Stage.encoder_deg`. There are no encoders."""
        return {}

    def faults(self) -> Sequence[str]:
        """See `Stage.faults`. There are none."""
        return ()

    def stop(self) -> None:
        """Do nothing: a virtual move is over when its method returns."""

    def close(self) -> None:
        """Do nothing: there is no port."""


class VirtualLight:
    """A light that accepts every setting; a ``drivers.light.Light``."""

    def __init__(self, clock: BenchClock) -> None:
        self._clock = clock
        self._settings = LightSettings()
        self.lit = False

    def identify(self) -> LightIdentity:
        """See `Light.identify`."""
        return LightIdentity(MAKER, MODEL, "none", "")

    def apply(self, settings: LightSettings) -> LightSettings:
        """See `Light.apply`."""
        self._settings = settings
        return settings

    def read(self) -> LightSettings:
        """See `Light.read`."""
        return self._settings

    def on(self) -> None:
        """See `Light.on`."""
        self._clock.sleep(LIGHT_ON_S)
        self.lit = True

    def off(self) -> None:
        """See `Light.off`."""
        self._clock.sleep(LIGHT_OFF_S)
        self.lit = False

    def is_on(self) -> bool:
        """See `Light.is_on`."""
        return self.lit

    def faults(self) -> Sequence[str]:
        """See `Light.faults`. There are none."""
        return ()

    def close(self) -> None:
        """Do nothing: there is no port."""


class VirtualCamera:
    """A camera that writes the stars of a rehearsed world; a ``drivers.camera.EventCamera``."""

    def __init__(
        self, serial: str, world: RehearsedWorld, stage: VirtualStage, light: VirtualLight, clock: BenchClock
    ) -> None:
        truth = world.truth(0.0).camera
        self._size = (truth.width, truth.height)
        self._serial = serial
        self._world = world
        self._stage = stage
        self._light = light
        self._clock = clock
        self._settings = CameraSettings()
        self._recordings = 0

    def identify(self) -> CameraIdentity:
        """See `EventCamera.identify`."""
        return CameraIdentity(MAKER, MODEL, "none", self._serial, "", *self._size)

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """See `EventCamera.apply`."""
        self._settings = settings
        return settings

    def filters(self) -> Mapping[str, bool]:
        """See `EventCamera.filters`. All are off."""
        return dict.fromkeys(FILTERS_TO_DISABLE, False)

    def temperature_c(self) -> float:
        """See `EventCamera.temperature_c`. Temperature of the rehearsed world at this time."""
        return self._world.temperature_c(self._clock.monotonic())

    def record(self, path: Path, duration_s: float) -> RecordingFacts:
        """Write the stars of this pose to a file, unless the rehearsed world decides that the recording fails."""
        seen = self._world.record(self._stage.position_deg(), self._clock.monotonic(), self._recordings)
        self._recordings += 1
        self._clock.sleep(duration_s + RECORD_EXTRA_S)
        if seen.mishap == "lost":
            raise RecordingFailed(
                "The recording was not completed (a rehearsed fault).",
                where="camera",
                remedy="Record again.",
            )
        edges = round(duration_s * self._light.read().frequency_hz) if self._light.is_on() else 0
        content = {
            "ids": seen.ids.tolist(),
            "points_px": np.round(seen.points_px, 6).tolist(),
            "sigma_px": seen.sigma_px,
            "image_size": list(self._size),
            "rising_edges": edges,
        }
        data = FIRST_LINE + json.dumps(content, separators=(",", ":")).encode() + b"\n"
        path.write_bytes(data)
        return RecordingFacts(
            serial=self._serial,
            model=MODEL,
            width=self._size[0],
            height=self._size[1],
            bytes=len(data),
            duration_s=duration_s,
            events=0,
            triggers=2 * edges,
            biases=dict(self._settings.biases),
            filters=self.filters(),
            temperature_c=round(seen.temperature_c, 3),
            rate_controller_in=1,  # all passes
            rate_controller_out=1,
        )

    def stop(self) -> None:
        """Do nothing: a virtual camera sends no stream."""

    def close(self) -> None:
        """Do nothing: there is no port."""


def read_view(path: Path, name: str, target: StarTarget) -> tuple[View, int]:
    """Read a rehearsed recording. Raises OSError, ValueError or KeyError if the file is none."""
    content = parse_json(read_bounded(path).removeprefix(FIRST_LINE))
    ids = np.array(content["ids"], dtype=np.int64)
    points = np.array(content["points_px"], dtype=np.float64).reshape(-1, 2)
    covariances = np.tile(np.eye(2) * max(content["sigma_px"], 1e-3) ** 2, (len(ids), 1, 1))
    width, height = content["image_size"]
    positions = np.asarray(target.positions_mm(ids), dtype=np.float64).reshape(-1, 2)
    return View(name, (width, height), ids, points, positions, covariances), content["rising_edges"]


def _configuration(station: Station) -> dict[str, Any]:
    """Return the configuration of the world: the simulation's, or one from the ``expected`` section."""
    expected = station.expected
    if station.simulation is not None or expected is None:
        return station.simulated_world
    width, height = expected.image_size
    camera = {
        "fx": expected.focal_px,
        "fy": expected.focal_px,
        "cx": 0.5 * (width - 1),
        "cy": 0.5 * (height - 1),
        "k1": expected.k1,
        "k2": expected.k2,
        "width": width,
        "height": height,
    }
    return {
        **station.simulated_world,
        "camera": camera,
        "collimator": {"r": expected.r_mm, "half_angle_deg": expected.half_angle_deg},
        "rehearsal": {"star_sigma_px": expected.star_sigma_px},
    }
