"""The interface of event cameras: each writes a recording to a file, and returns the facts about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable


@dataclass(frozen=True)
class CameraIdentity:
    """The identity of a camera, as it states it itself.

    Attributes
    ----------
    maker, model, sensor, serial, firmware
        Empty if the camera does not state it.
    width, height
        Size of the sensor, px.
    firmware_built
        When the firmware was built; empty if the camera does not state it.
    link_mbit_s
        Speed of its USB connection, Mbit/s: 480 for USB 2, 5000 or more for USB 3; None if it is not known.
    """

    maker: str
    model: str
    sensor: str
    serial: str
    firmware: str
    width: int
    height: int
    firmware_built: str = ""
    link_mbit_s: int | None = None


@dataclass(frozen=True)
class FoundCamera:
    """A camera that is connected.

    Attributes
    ----------
    driver, serial
        The driver's name and the camera's serial number, as a station file gives them.
    description
        What is known of the camera, for the operator.
    trouble
        Why the camera cannot be used as it is; empty if it can.
    source
        What a station file gives as ``source`` for a camera that its serial number alone does not identify.
    """

    driver: str
    serial: str
    description: str
    trouble: str = ""
    source: str = ""


@dataclass(frozen=True)
class CameraSettings:
    """Settings made before a recording.

    Attributes
    ----------
    biases
        Offsets from the factory value by name, in the camera's own steps.
    trigger_in
        Whether the trigger input is on.
    roi
        The only part of the sensor that sends events, px: column and row of its upper left pixel, width and height;
        None for the whole sensor.
    """

    biases: Mapping[str, int] = field(default_factory=dict)
    trigger_in: bool = True
    roi: tuple[int, int, int, int] | None = None


@dataclass(frozen=True)
class RecordingFacts:
    """What is known of one recording besides its bytes.

    Attributes
    ----------
    serial, model
        The camera that recorded.
    width, height
        Size of the sensor, px.
    bytes
        Length of the file.
    duration_s
        Time on the sensor's clock that the file covers, s.
    events, triggers
        Counted in the file: contrast change events; trigger edges (rising and falling).
    biases
        Offsets from the factory value, read back from the camera; empty if they cannot be read back.
    filters
        On-chip filters by name ("afk", "stc", "trail", "erc") and whether each is on; the camera lacks those not named.
    rate_controller_in, rate_controller_out
        Events into and out of the sensor's rate controller by its own count; None if it does not count.
    temperature_c
        Temperature of the sensor, deg C; None if it is not measured.
    illumination_lux
        Illumination of the sensor, lx; None if it is not measured.
    gaps
        Where the computer or the link lost data, in sentences; empty if nothing was lost.
    complete
        False if the recording ended before its time; the file can then be read up to its end.
    """

    serial: str
    model: str
    width: int
    height: int
    bytes: int
    duration_s: float
    events: int
    triggers: int
    biases: Mapping[str, int]
    filters: Mapping[str, bool]
    rate_controller_in: int | None = None
    rate_controller_out: int | None = None
    temperature_c: float | None = None
    illumination_lux: float | None = None
    gaps: Sequence[str] = ()
    complete: bool = True


class EventCamera(Protocol):
    """An event camera. Its methods raise ``drivers.errors.DriverError`` and nothing else."""

    def identify(self) -> CameraIdentity:
        """Read the camera's identity.

        Returns
        -------
        CameraIdentity
            As the camera states it.

        Raises
        ------
        WrongDevice
            If the serial number differs from the one given when the camera was opened.
        """

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set biases, region of interest and trigger input, and switch off AFK, STC, TRAIL and ERC.

        Biases that are not named are set to their factory value, so that equal settings are equal states.

        Parameters
        ----------
        settings
            The wanted settings.

        Returns
        -------
        CameraSettings
            What was read back from the camera.

        Raises
        ------
        CameraSettingRefused
            If the camera does not accept a setting, or another value is read back.
        """

    def filters(self) -> Mapping[str, bool]:
        """Read which on-chip filters are on.

        Returns
        -------
        Mapping of str to bool
            The filters that the camera has by name, and whether each is on.
        """

    def temperature_c(self) -> float | None:
        """Measure the temperature of the sensor.

        Returns
        -------
        float or None
            Temperature, deg C; None if the camera cannot measure it.
        """

    def record(self, path: Path, duration_s: float) -> RecordingFacts:
        """Record into a new RAW file: header and the camera's own bytes, synced to disk.

        The call blocks, and waits through the clock given at opening. If the clock interrupts the wait, the file is
        closed and the stream stopped before the interrupt is passed on.

        Parameters
        ----------
        path
            The file to make; it must not exist.
        duration_s
            The file covers at least this time on the sensor's clock, s.

        Returns
        -------
        RecordingFacts
            What is known of the recording.

        Raises
        ------
        RecordingFailed
            If the file cannot be made or written, or the words are malformed; what was recorded before is kept.
        CameraLost
            If the camera goes away meanwhile; what was recorded before is kept.
        """

    def stop(self) -> None:
        """End a recording early, if there is one. Callable from any thread."""

    def close(self) -> None:
        """Release the camera."""


@runtime_checkable
class PreviewCamera(Protocol):
    """An `EventCamera` that has a cheaper way to record for a live picture."""

    def preview(self, path: Path, duration_s: float) -> RecordingFacts:
        """Record a slice for a live picture. It may take shortcuts that no measurement may take.

        Parameters
        ----------
        path
            The file to make; it must not exist.
        duration_s
            The file covers at least this time on the sensor's clock, s.

        Returns
        -------
        RecordingFacts
            What is known of the recording.

        Raises
        ------
        RecordingFailed, CameraLost
            As `EventCamera.record`.
        """


@runtime_checkable
class StatesBiasRanges(Protocol):
    """A camera that can say which biases it has, and their ranges."""

    def bias_ranges(self) -> Mapping[str, tuple[int, int]]:
        """Return the lowest and highest value of each bias.

        Returns
        -------
        Mapping[str, tuple[int, int]]
            Range by name, in the camera's own steps.
        """
