"""The two kinds of cameras a bench may have, and what a run does otherwise for each.

An event camera records the light's flicker, a frame camera takes pictures in steady light. Everything else of a run
is the same for both: poses, journal, evidence, calibration, report.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Protocol, cast

from bench.stations.devices import Camera
from bench.stations.station import Station
from bench.stations.station_cameras import FrameCameraConfig
from bench.views.frames import frame_gates, frame_rejection_reasons, measure_frames
from bench.views.gates import FILTERS_TO_DISABLE, Gate, recording_gates, rejection_reasons
from bench.views.measure import ExpectedGrid, Measurement, measure
from bench.views.recording_window import periods_in_window, recording_duration_s
from calib.target import StarTarget
from drivers.camera import CameraSettings, EventCamera, RecordingFacts
from drivers.camera.frames import FrameCamera, FrameFacts, FrameSettings
from drivers.camera.recording import compile_decoder
from sequences.script import Flicker, RecordStep

StoredFacts = Mapping[str, Any]
"""A driver's facts of a recording by field, as the journal holds them."""


class CameraKind(Protocol):
    """What a run does with its camera."""

    name: str
    """In results: ``event`` or ``frame``."""
    ending: str
    """How the names of its recordings end."""

    def light_for(self, flicker: Flicker) -> Flicker:
        """What the light does where a sequence asks for a flicker."""
        ...

    def prepare(self, camera: Camera) -> tuple[dict[str, Any], list[str]]:
        """Set the camera; return the settings as read back, and every reason against a run."""
        ...

    def record(
        self, camera: Camera, path: Path, step: RecordStep, frequency_hz: float
    ) -> RecordingFacts | FrameFacts:
        """Record into a new file."""
        ...

    def measure(
        self,
        path: Path,
        step: RecordStep,
        frequency_hz: float,
        target: StarTarget,
        expect: ExpectedGrid | None,
    ) -> Measurement:
        """Find the stars in a recording; where ``expect`` says, if the tag does not tell which they are."""
        ...

    def judge(
        self, facts: StoredFacts, step: RecordStep, frequency_hz: float, found: Measurement
    ) -> tuple[list[Gate], list[str]]:
        """Judge a recording by its numbers; return also what speaks against it besides a failed gate."""
        ...

    def counts(self, facts: StoredFacts) -> dict[str, Any]:
        """Give what results tell of a recording."""
        ...

    def conditions(self, accepted: Sequence[StoredFacts]) -> dict[str, Any]:
        """Give what results tell of the camera's state over the recordings accepted."""
        ...


class EventKind:
    """An event camera under a flickering light.

    Parameters
    ----------
    biases
        Offsets from the factory values.
    roi
        The only part of the sensor that sends events; None for all of it.
    """

    name = "event"
    ending = ".raw"

    def __init__(self, biases: Mapping[str, int], roi: tuple[int, int, int, int] | None = None) -> None:
        self._settings = CameraSettings(biases, trigger_in=True, roi=roi)

    def light_for(self, flicker: Flicker) -> Flicker:
        """The flicker itself."""
        return flicker

    def prepare(self, camera: Camera) -> tuple[dict[str, Any], list[str]]:
        """Set biases and trigger input, and see that no filter eats flicker; have ready what recording needs."""
        compile_decoder()
        event_camera = cast("EventCamera", camera)
        settings = event_camera.apply(self._settings)
        filters = event_camera.filters()
        reasons = [
            f"camera: its {f.upper()} filter cannot be switched off"
            for f in FILTERS_TO_DISABLE
            if filters.get(f)
        ]
        if not settings.trigger_in:
            reasons.append("camera: its trigger input cannot be enabled")
        return asdict(settings), reasons

    def record(self, camera: Camera, path: Path, step: RecordStep, frequency_hz: float) -> RecordingFacts:
        """Record so long that the window's whole periods lie inside."""
        duration_s = recording_duration_s(step.window_ms, frequency_hz)
        return cast("EventCamera", camera).record(path, duration_s)

    def measure(
        self,
        path: Path,
        step: RecordStep,
        frequency_hz: float,
        target: StarTarget,
        expect: ExpectedGrid | None,
    ) -> Measurement:
        """Find the stars in the event image of whole flicker periods."""
        return measure(
            path,
            name=step.pose.name,
            target=target,
            image=step.image,
            periods=periods_in_window(step.window_ms, frequency_hz),
            expected_hz=frequency_hz,
            expect=expect,
        )

    def judge(
        self, facts: StoredFacts, step: RecordStep, frequency_hz: float, found: Measurement
    ) -> tuple[list[Gate], list[str]]:
        """Judge stars, event rate, triggers, flicker and motion."""
        recorded = RecordingFacts(**facts)
        return (
            recording_gates(recorded, step.gates, frequency_hz, found.facts, found.stars),
            rejection_reasons(recorded, step.gates, ()),
        )

    def counts(self, facts: StoredFacts) -> dict[str, Any]:
        """Events, triggers, span and rate."""
        recorded = RecordingFacts(**facts)
        events, duration_s = recorded.events, recorded.duration_s
        return {
            "events": events,
            "triggers": recorded.triggers,
            "duration_s": duration_s,
            "event_rate_mev_s": events / duration_s / 1e6 if duration_s else None,
            "temperature_c": recorded.temperature_c,
        }

    def conditions(self, accepted: Sequence[StoredFacts]) -> dict[str, Any]:
        """Biases and filters as read back last, illumination then, mean temperature."""
        recorded = [RecordingFacts(**facts) for facts in accepted]
        last = recorded[-1]
        temperatures = [one.temperature_c for one in recorded if one.temperature_c is not None]
        return {
            "biases": last.biases,
            "filters": last.filters,
            "temperature_c": sum(temperatures) / len(temperatures) if temperatures else None,
            "illumination_lux": last.illumination_lux,
        }


class FrameKind:
    """A frame camera under a steady light.

    Parameters
    ----------
    pictures
        How many are taken at each pose.
    settings
        Of the camera.
    """

    name = "frame"
    ending = ".tif"

    def __init__(self, pictures: int, settings: FrameSettings) -> None:
        self._pictures = pictures
        self._settings = settings

    def light_for(self, flicker: Flicker) -> Flicker:
        """Let the light burn steadily at the flicker's brighter level: no picture depends on when it was taken."""
        return replace(flicker, waveform="steady")

    def prepare(self, camera: Camera) -> tuple[dict[str, Any], list[str]]:
        """Set exposure and gain."""
        return asdict(cast("FrameCamera", camera).apply(self._settings)), []

    def record(self, camera: Camera, path: Path, step: RecordStep, frequency_hz: float) -> FrameFacts:  # noqa: ARG002
        """Take the pictures."""
        return cast("FrameCamera", camera).capture(path, self._pictures)

    def measure(
        self,
        path: Path,
        step: RecordStep,
        frequency_hz: float,  # noqa: ARG002
        target: StarTarget,
        expect: ExpectedGrid | None,
    ) -> Measurement:
        """Find the stars in the mean of the pictures."""
        return measure_frames(path, name=step.pose.name, target=target, expect=expect)

    def judge(
        self,
        facts: StoredFacts,
        step: RecordStep,
        frequency_hz: float,  # noqa: ARG002
        found: Measurement,
    ) -> tuple[list[Gate], list[str]]:
        """Judge stars, saturation and motion."""
        recorded = FrameFacts(**facts)
        return frame_gates(recorded, step.gates, found), frame_rejection_reasons(recorded)

    def counts(self, facts: StoredFacts) -> dict[str, Any]:
        """Pictures, and how many of their pixels are saturated."""
        recorded = FrameFacts(**facts)
        return {
            "pictures": recorded.frames,
            "bits": recorded.bits,
            "saturated_percent": 100 * recorded.saturated_share,
        }

    def conditions(self, accepted: Sequence[StoredFacts]) -> dict[str, Any]:
        """Pictures a pose, their depth, and the settings that the station names."""
        last = FrameFacts(**accepted[-1])
        asked = {name: value for name, value in asdict(self._settings).items() if value is not None}
        return {"pictures": last.frames, "bits": last.bits, **asked}


def camera_kind(station: Station) -> CameraKind:
    """Find out which kind a station's camera is."""
    said = station.camera
    if isinstance(said, FrameCameraConfig):
        return FrameKind(said.pictures, said.settings())
    return EventKind(said.biases.model_dump(), said.roi)
