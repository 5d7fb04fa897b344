"""The two kinds of cameras that a bench may have, and what a run does differently for each.

An event camera records the light's flicker; a frame camera takes images in steady light. All else is the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from bench.base.compiled_loops import STARS, compile_loops
from bench.measure.gates import FILTERS_TO_DISABLE, Gate, recording_gates, rejection_reasons
from bench.stations.sections import FrameCameraSection
from bench.stations.station import Station
from calib.target import StarTarget
from drivers.camera import CameraSettings, RecordingFacts
from drivers.camera.frames import FrameFacts, FrameSettings
from sequences.script import Flicker, RecordStep

if TYPE_CHECKING:  # a plan needs none of these
    from bench.measure.measure import ExpectedGrid, Measurement
    from bench.record.events import RecordedData
    from bench.record.measured_facts import RecordingCounts
    from bench.record.results import CameraConditions
    from bench.stations.devices import Camera
    from drivers.camera import EventCamera
    from drivers.camera.frames import FrameCamera

Facts = TypeVar("Facts", RecordingFacts, FrameFacts)
RECORDING_MARGIN_S = 1e-3  # Two periods of 60 Hz are still whole if the light is 2 % slow
"""Time recorded in addition to the whole periods and the one that is cut at the ends, s."""


def periods_in_window(window_ms: float, frequency_hz: float) -> int:
    """Return the number of whole flicker periods nearest to a window, at least one.

    An image over a part of a period would favour one polarity, so windows are rounded to whole periods.

    >>> periods_in_window(33, 60)
    2
    """
    return max(1, round(window_ms * 1e-3 * frequency_hz))


def recording_duration_s(window_ms: float, frequency_hz: float) -> float:
    """Return the recording time, s, that contains the window's whole periods at any phase of the light.

    >>> round(recording_duration_s(33, 60), 4)
    0.051
    """
    return (periods_in_window(window_ms, frequency_hz) + 1) / frequency_hz + RECORDING_MARGIN_S


def event_camera(camera: Camera) -> EventCamera:
    """Return the camera of a station whose file states an event camera; TypeError for another one."""
    if hasattr(camera, "capture"):
        raise TypeError("this is a frame camera")
    return camera


def frame_camera(camera: Camera) -> FrameCamera:
    """Return the camera of a station whose file states a frame camera; TypeError for another one."""
    if hasattr(camera, "record"):
        raise TypeError("this is an event camera")
    return camera


class EventKind:
    """An event camera under a flickering light; without a region of interest, the whole sensor sends events."""

    name = "event"  # In results
    ending = ".raw"  # Of the file name of a recording

    def __init__(
        self,
        biases: Mapping[str, int],
        roi: tuple[int, int, int, int] | None = None,
    ) -> None:
        self._settings = CameraSettings(biases, trigger_in=True, roi=roi)

    def light_for(self, flicker: Flicker) -> Flicker:
        """Return what the light does if a sequence asks for a flicker: the flicker itself."""
        return flicker

    def prepare(self, camera: Camera) -> tuple[dict[str, Any], list[str]]:
        """Set the camera, and return every reason against a run, such as a filter that stays on and removes flicker."""
        from drivers.camera.recording import compile_decoder

        compile_decoder()
        opened = event_camera(camera)
        settings, filters = opened.apply(self._settings), opened.filters()
        reasons = [
            f"camera: its {f.upper()} filter cannot be switched off"
            for f in FILTERS_TO_DISABLE
            if filters.get(f)
        ]
        if not settings.trigger_in:
            reasons.append("camera: its trigger input cannot be enabled")
        return asdict(settings), reasons

    def record(self, camera: Camera, path: Path, step: RecordStep, frequency_hz: float) -> RecordingFacts:
        """Record into a new file, long enough for the window's whole periods at the flicker's frequency."""
        duration_s = recording_duration_s(step.window_ms, frequency_hz)
        return event_camera(camera).record(path, duration_s)

    def measure(
        self,
        path: Path,
        step: RecordStep,
        frequency_hz: float,
        target: StarTarget,
        expected_grid: ExpectedGrid | None,
        *,
        motion: bool = True,
    ) -> Measurement:
        """Find the stars in the image of whole periods; ``expected_grid`` is for where the tag does not label them."""
        compile_loops(STARS)
        name, periods = step.pose.name, periods_in_window(step.window_ms, frequency_hz)
        from bench.measure.measure import measure

        return measure(
            path,
            name=name,
            target=target,
            image=step.image,
            periods=periods,
            expected_hz=frequency_hz,
            expected_grid=expected_grid,
            motion=motion,
        )

    def judge(
        self, facts: RecordedData, step: RecordStep, frequency_hz: float, measurement: Measurement
    ) -> tuple[list[Gate], list[str]]:
        """Judge a recording by its numbers: stars, event rate, triggers, flicker and motion."""
        recorded = _recorded(RecordingFacts, facts)
        gates = recording_gates(recorded, step.gates, frequency_hz, measurement.facts, measurement.stars)
        return gates, rejection_reasons(recorded, step.gates)

    def counts(self, facts: RecordedData) -> RecordingCounts:
        """Return what results state about a recording: events, triggers, duration and event rate."""
        recorded = _recorded(RecordingFacts, facts)
        events, duration_s = recorded.events, recorded.duration_s
        return {
            "events": events,
            "triggers": recorded.triggers,
            "duration_s": duration_s,
            "event_rate_mev_s": events / duration_s / 1e6 if duration_s else None,
            "temperature_c": recorded.temperature_c,
        }

    def conditions(self, accepted: Sequence[RecordedData]) -> CameraConditions:
        """Return the camera's state at the last of the accepted recordings, at least one; and the mean temperature."""
        recorded = [_recorded(RecordingFacts, facts) for facts in accepted]
        last = recorded[-1]
        temperatures = [record.temperature_c for record in recorded if record.temperature_c is not None]
        return {
            "biases": last.biases,
            "filters": last.filters,
            "temperature_c": sum(temperatures) / len(temperatures) if temperatures else None,
            "illumination_lux": last.illumination_lux,
        }


class FrameKind:
    """A frame camera under a steady light."""

    name = "frame"
    ending = ".tif"

    def __init__(self, frames: int, settings: FrameSettings) -> None:
        self._frames = frames
        self._settings = settings

    def light_for(self, flicker: Flicker) -> Flicker:
        """See `EventKind.light_for`. Steady light at the flicker's high level."""
        return replace(flicker, waveform="steady")

    def prepare(self, camera: Camera) -> tuple[dict[str, Any], list[str]]:
        """See `EventKind.prepare`. Sets exposure and gain."""
        return asdict(frame_camera(camera).apply(self._settings)), []

    def record(self, camera: Camera, path: Path, step: RecordStep, frequency_hz: float) -> FrameFacts:  # noqa: ARG002
        """See `EventKind.record`. Takes the frames."""
        return frame_camera(camera).capture(path, self._frames)

    def measure(
        self,
        path: Path,
        step: RecordStep,
        frequency_hz: float,  # noqa: ARG002
        target: StarTarget,
        expected_grid: ExpectedGrid | None,
        *,
        motion: bool = True,  # noqa: ARG002
    ) -> Measurement:
        """See `EventKind.measure`. Uses the mean of the frames."""
        compile_loops(STARS)
        from bench.measure.measure_frames import measure_frames

        return measure_frames(path, name=step.pose.name, target=target, expected_grid=expected_grid)

    def judge(
        self,
        facts: RecordedData,
        step: RecordStep,
        frequency_hz: float,  # noqa: ARG002
        measurement: Measurement,
    ) -> tuple[list[Gate], list[str]]:
        """See `EventKind.judge`. Judges stars, saturation and motion."""
        from bench.measure.measure_frames import frame_gates, frame_rejection_reasons

        recorded = _recorded(FrameFacts, facts)
        gates = frame_gates(recorded, step.gates, measurement)
        return gates, frame_rejection_reasons(recorded)

    def counts(self, facts: RecordedData) -> RecordingCounts:
        """See `EventKind.counts`. Number of frames, and percentage of saturated pixels."""
        recorded = _recorded(FrameFacts, facts)
        return {
            "pictures": recorded.frames,
            "bits": recorded.bits,
            "saturated_percent": 100 * recorded.saturated_share,
        }

    def conditions(self, accepted: Sequence[RecordedData]) -> CameraConditions:
        """See `EventKind.conditions`. Frames per pose, bit depth, and the settings asked for."""
        last = _recorded(FrameFacts, accepted[-1])
        conditions: CameraConditions = {"pictures": last.frames, "bits": last.bits}
        if self._settings.exposure is not None:
            conditions["exposure"] = self._settings.exposure
        if self._settings.gain is not None:
            conditions["gain"] = self._settings.gain
        return conditions


def _recorded(facts_of: Callable[..., Facts], data: RecordedData) -> Facts:
    """Return the facts of a recording as the driver of this kind of camera has them."""
    return facts_of(**data)


CameraKind = EventKind | FrameKind
"""What a run does with its camera."""


def camera_kind(station: Station) -> CameraKind:
    """Return what a run does with a station's camera."""
    config = station.camera
    if isinstance(config, FrameCameraSection):
        return FrameKind(config.pictures, config.settings())
    return EventKind(config.biases.named(), config.roi)
