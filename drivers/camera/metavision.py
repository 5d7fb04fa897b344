"""Driver of Prophesee cameras by the HAL of Metavision or OpenEB.

The maker's software is imported when a camera is opened, not before. Only its calls that return at once are used,
since its blocking calls keep every other Python thread from running. It writes the camera's bytes to the file itself.
It does not report a full disk, so the driver reads the file afterwards to check that all bytes arrived.

The HAL gives a camera back when the last of its objects goes, and has no call for it. An error that is kept, as the
cause of a hold, keeps the variables of all functions that it passed, and with them such objects. The same program
could then not open the camera again. Opening takes 2.6 s or more, and a command that the camera does not answer 10 s.
No other thread of Python runs then.
"""

from __future__ import annotations

import math
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, Final

from drivers.camera import CameraIdentity, CameraSettings, RecordingFacts
from drivers.camera.metavision_discovery import (
    link_mbit_s,
    listening,
    not_opened,
    reason_of,
    stated,
    vendor_software,
)
from drivers.camera.metavision_settings import (
    apply_settings,
    bias_ranges,
    factory_biases,
    read_biases,
    read_filters,
    read_monitoring,
)
from drivers.camera.raw_file import RawFile, RecordingStatistics
from drivers.camera.raw_writer import check_new, check_space, sync_file
from drivers.camera.recording import (
    RecordingOutcome,
    UsbCameraDriver,
    connection_lost,
    incomplete_recording_error,
    recording_facts,
)
from drivers.clock import Clock
from drivers.errors import (
    CameraError,
    CameraLost,
    CameraSettingRefused,
    RecordingFailed,
    RecordingFileError,
)
from drivers.lateness import own_lateness

_POLL_S: Final = 0.001  # Of the vendor's software, which has no wait with a deadline


_LARGEST_STEP_US: Final = 1_000_000
"""Between two buffers of one stream lie milliseconds. A longer step means that the sensor's clock was restarted."""


@contextmanager
def lets_go(*, holds: bool = False) -> Iterator[None]:
    """Empty the variables of the functions that an error has passed on its way out of the block.

    ``holds``: the block may keep other threads from running, so that their delay does not count.
    """
    outside = sys.exception()
    try:
        with own_lateness().interpreter_held() if holds else nullcontext():
            yield
    except BaseException as error:
        _clear(error, outside)
        raise


def _clear(error: BaseException | None, outside: BaseException | None) -> None:
    """Empty the variables behind an error and its causes, up to the error that the caller was handling already."""
    cleared: set[int] = set()
    waiting = [error]
    while waiting:
        exception = waiting.pop()
        if exception is None or exception is outside or id(exception) in cleared:
            continue
        cleared.add(id(exception))
        traceback.clear_frames(exception.__traceback__)
        waiting += [exception.__cause__, exception.__context__]


class MetavisionEvk4(UsbCameraDriver):
    """An ``EventCamera`` behind ``metavision_hal``; ``serial`` None accepts any camera.

    ``device`` is an open HAL device: a camera, or a RAW file opened as one.
    """

    def __init__(self, device: Any, hal: Any, *, serial: str | None, clock: Clock) -> None:
        super().__init__(serial=serial, clock=clock)
        self._device = device
        self._hal = hal
        self._factory: Mapping[str, int] = {}

    @classmethod
    @lets_go(holds=True)
    def open(cls, *, serial: str | None = None, clock: Clock) -> MetavisionEvk4:
        """Open a camera in the format EVT3; ``serial`` None opens the first camera found.

        Raises `CameraNotFound` if there is no such camera, or another program uses it; `CameraBusy` if another process
        of this bench has locked it (with a serial number given, the camera has not been touched); `WrongDevice` if
        another camera answers; `CameraSettingRefused` if the camera does not send EVT3, or is connected by USB 2.
        """
        return cls(None, vendor_software(), serial=serial, clock=clock).open_device()

    def _opened(self) -> Any:
        """Open the HAL's device in the format EVT3. Raises CameraNotFound."""
        config = self._hal.DeviceConfig()
        config.set_format("EVT3")
        reason = ""
        device = None
        try:
            with listening():
                device = self._hal.DeviceDiscovery.open(self._serial or "", config)
        except RuntimeError as error:
            reason = f" ({reason_of(error)})"
        if device is None:
            raise not_opened(self._serial, reason)
        return device

    @lets_go(holds=True)
    def identify(self) -> CameraIdentity:
        """Read the camera's identity as the HAL states it; model and firmware only if it names a release version.

        Raises `WrongDevice` if the serial number differs from the one given when the camera was opened.
        """
        try:
            who = self._facility("get_i_hw_identification", "identification")
            geometry = self._facility("get_i_geometry", "geometry")
            about = dict(who.get_system_info())
            version = next((key for key in about if key.endswith(" Release Version")), "")
            identity = CameraIdentity(
                maker=str(who.get_integrator()),
                model=version.removesuffix(" Release Version"),
                sensor=str(who.get_sensor_info().name),
                serial=str(who.get_serial()),
                firmware=str(about.get(version, "")),
                width=int(geometry.get_width()),
                height=int(geometry.get_height()),
                firmware_built=stated(about, " Build Date"),
                link_mbit_s=link_mbit_s(about),
            )
        except RuntimeError as error:
            raise self._lost(error) from error
        return self._require_serial(identity)

    @lets_go(holds=True)
    def apply(self, settings: CameraSettings) -> CameraSettings:
        """See `EventCamera.apply`."""
        return apply_settings(self._device, self._hal, settings, self._factory, where=self._where)

    @lets_go(holds=True)
    def bias_ranges(self) -> Mapping[str, tuple[int, int]]:
        """See `StatesBiasRanges.bias_ranges`."""
        return bias_ranges(self._device, where=self._where)

    @lets_go(holds=True)
    def filters(self) -> Mapping[str, bool]:
        """See `EventCamera.filters`."""
        return read_filters(self._device, self._hal, where=self._where)

    def temperature_c(self) -> float | None:
        """See `EventCamera.temperature_c`."""
        return read_monitoring(self._device, "get_temperature")

    @lets_go()
    def record(self, path: Path, duration_s: float) -> RecordingFacts:
        """Record into a new RAW file at least ``duration_s`` on the sensor's clock; see `EventCamera.record`.

        A file that covers less time than was streamed is kept, as is what was recorded before the camera was lost.
        """
        self._begin(duration_s)
        check_new(path)
        identity = self.identify()
        biases, filters = read_biases(self._device, where=self._where), self.filters()
        complete = self._run(path, duration_s)
        scan = self._scan(path)
        if complete and scan.duration_s < duration_s:
            check_space(path)
            raise RecordingFailed(
                f"The recording covers only {scan.duration_s:.6f} s of the sensor's clock, not {duration_s} s.",
                where=str(path),
                remedy="Record it again.",
            )
        return recording_facts(
            identity,
            RecordingOutcome(scan, scan.bytes, complete),
            biases=biases,
            filters=filters,
            temperature_c=self.temperature_c(),
            illumination_lux=read_monitoring(self._device, "get_illumination"),
        )

    def close(self) -> None:
        """See `EventCamera.close`."""
        self._device = None
        if self._lock is not None:
            self._lock.release()

    # ------------------------------------------------------------- streaming

    def _run(self, path: Path, duration_s: float) -> bool:
        """Stream into the file until the duration is covered; return whether it was."""
        stream = self._facility("get_i_events_stream", "event stream")
        # Logging starts before the stream does, or its first buffers would be missing.
        try:
            logs = stream.log_raw_data(str(path))
        except RuntimeError as error:  # the HAL reads the header's values from the camera
            raise self._lost(error) from error
        if not logs:
            raise RecordingFailed(
                "The camera's software cannot write this file.",
                where=str(path),
                remedy="Check that the folder exists and that you may write to it.",
            )
        try:
            stream.start()
            return self._poll(stream, duration_s)
        except RuntimeError as error:
            raise incomplete_recording_error(self._lost(error), path) from error
        except CameraLost as error:
            raise incomplete_recording_error(error, path) from error
        finally:
            for end in (stream.stop_log_raw_data, stream.stop):
                with suppress(RuntimeError):
                    end()
            sync_file(path)

    def _poll(self, stream: Any, duration_s: float) -> bool:
        """Take buffers until the duration is covered; return False if stopped, or if the stream ended."""
        decoder = self._facility("get_i_events_stream_decoder", "decoder")
        wanted_us = math.ceil(duration_s * 1e6)
        covered_us, last_us = 0, -1
        deadline = self._clock.monotonic() + self.SILENCE_S
        while covered_us < wanted_us:
            ready = stream.poll_buffer()
            if self._stop_asked.is_set() or ready < 0:
                return False
            if ready == 0:
                if self._clock.monotonic() > deadline:
                    raise self._silent()
                self._clock.sleep(_POLL_S)
                continue
            decoder.decode(stream.get_latest_raw_data())
            now_us = int(decoder.get_last_timestamp())
            step_us = now_us - last_us
            if last_us >= 0 and 0 < step_us < _LARGEST_STEP_US:
                covered_us += step_us
                deadline = self._clock.monotonic() + self.SILENCE_S
            last_us = now_us
            self._clock.sleep(0.0)
        return True

    def _scan(self, path: Path) -> RecordingStatistics:
        """Read the new file once. Raises RecordingFailed."""
        try:
            return RawFile.open(path).scan(self._clock.monotonic)
        except RecordingFileError as error:
            check_space(path)
            raise RecordingFailed(error.what, where=error.where, remedy="Record it again.") from error

    # ------------------------------------------------------------- internals

    @property
    def _where(self) -> str:
        return f"camera {self._serial or 'at Metavision'}"

    def _facility(self, getter: str, name: str) -> Any:
        """Return a facility that every camera has. Raises CameraError if this camera lacks it, or is closed."""
        facility = getattr(self._device, getter)() if self._device is not None else None
        if facility is None:
            raise CameraError(
                f"The camera's {name} cannot be reached.",
                where=self._where,
                remedy="Reconnect the camera, then resume the run.",
            )
        return facility

    def _check_opened(self, identity: CameraIdentity) -> None:
        """Refuse a camera that does not send EVT3; keep the biases that it was opened with."""
        encoding = str(
            self._facility("get_i_hw_identification", "identification").get_current_data_encoding_format()
        )
        if not encoding.startswith("EVT3"):
            raise CameraSettingRefused(
                f"The camera sends {encoding or 'an unknown format'}, not EVT3.",
                where=self._where,
                remedy="Update the camera's firmware, or use a camera that sends EVT3.",
            )
        self._factory = factory_biases(self._device, identity.sensor, where=self._where)

    def _lost(self, error: RuntimeError) -> CameraLost:
        return connection_lost(reason_of(error), self._where)
