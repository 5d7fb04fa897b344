"""What the bench expects of an event camera: it writes a recording to a file, and says how it went."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True)
class CameraIdentity:
    """Which camera it is, as it says itself."""

    maker: str
    model: str
    sensor: str
    serial: str
    firmware: str
    width: int
    height: int


@dataclass(frozen=True)
class FoundCamera:
    """A camera that is connected: what a station file calls its driver and serial number, and what is known of it.

    ``trouble`` says why it cannot be used as it is; empty when it can. ``source`` is what a station file calls the
    place of a camera that is not found by its serial number alone.
    """

    driver: str
    serial: str
    description: str
    trouble: str = ""
    source: str = ""


@dataclass(frozen=True)
class CameraSettings:
    """What is set before recording.

    Biases are offsets from the factory value; ``roi`` the only part of the sensor that sends events: column and row
    of its upper left pixel, width and height; None for all of it.
    """

    biases: Mapping[str, int] = field(default_factory=dict)
    trigger_in: bool = True
    roi: tuple[int, int, int, int] | None = None


@dataclass(frozen=True)
class RecordingFacts:
    """What is known of one recording besides its bytes.

    Attributes
    ----------
    duration_s
        Span of the camera's own clock covered by the file.
    biases
        Offsets from the factory value, read back from the camera; empty where it cannot tell.
    filters
        On-chip filters by name ("afk", "stc", "trail", "erc") and whether each is on; missing = the camera has none.
    events, triggers
        Counted in the file: contrast events; trigger edges (rising and falling).
    rate_controller_in, rate_controller_out
        Events into and out of the sensor's rate controller as it counted them; None when it does not.
    gaps
        Where the host or the link lost data, in plain words; empty when nothing was lost.
    complete
        False when the recording ended before its time; the file is then readable up to its end.
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
    """An event camera. All methods raise ``drivers.errors.DriverError`` and nothing else."""

    def identify(self) -> CameraIdentity:
        """Ask who it is. Raises WrongDevice when the serial number differs from the given one."""
        ...

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set biases and trigger input, switch AFK, STC, TRAIL and ERC off; return what was read back."""
        ...

    def filters(self) -> Mapping[str, bool]:
        """On-chip filters the camera has, and whether each is on."""
        ...

    def temperature_c(self) -> float | None:
        """Sensor temperature, or None where the camera cannot tell."""
        ...

    def record(self, path: Path, duration_s: float) -> RecordingFacts:
        """Record that long into a new RAW file: header, the camera's own bytes, synced to disk.

        Blocks; waits through the clock given at opening. The file holds at least ``duration_s`` of the
        camera's clock. Raises RecordingFailed (with the partial file left in place, readable), CameraLost.
        An interrupt by the clock closes the file and stops the stream before it goes on.
        """
        ...

    def stop(self) -> None:
        """Stop streaming, if it does. Callable from any thread."""
        ...

    def close(self) -> None:
        """Let the camera go."""
        ...
