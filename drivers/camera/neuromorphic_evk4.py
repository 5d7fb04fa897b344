"""Driver of the EVK4 by ``neuromorphic-drivers`` (extra ``evk4``): the camera's USB bytes, and losses on the way.

That package needs no software of the maker. It streams from opening on, so a recording drops what has queued up, and
the packet that was being filled meanwhile (at a low event rate it reaches back half a second). The recording begins at
the next TIME_HIGH word, from which every decoder has a clock. The package has no anti-flicker, STC or trail filter, its
rate limiter stays off, and it sets biases but cannot read them back.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.camera import CameraIdentity, CameraSettings, FoundCamera, RecordingFacts
from drivers.camera.evt3 import first_time_high
from drivers.camera.raw_header import render_header
from drivers.camera.recording import (
    BIASES,
    UsbCameraDriver,
    check_bias,
    connection_lost,
    recording_facts,
    refuse_roi,
    refuse_unknown_biases,
)
from drivers.camera.usb_permission import only_camera_kind, only_camera_mbit_s
from drivers.clock import Clock
from drivers.errors import CameraError, CameraLost, CameraNotFound, CameraSoftwareMissing

POLL_S: Final = 0.02
"""Longest wait for bytes, s; other threads run meanwhile."""

_UNKNOWN_KIND: Final = ("unknown maker", "camera with an IMX636")
"""The package opens cameras of several makers by the same name, and does not say which it has opened."""


def discover() -> tuple[FoundCamera, ...]:
    """List the EVK4 that are connected."""
    package = import_package()
    try:
        listed = package.list_devices()
    except RuntimeError as error:
        raise CameraError(
            f"The USB devices cannot be listed ({error}).",
            where="neuromorphic-drivers",
            remedy="Check that this computer has USB, and that this user may use it.",
        ) from error
    kind = only_camera_kind() or _UNKNOWN_KIND
    return tuple(
        FoundCamera("neuromorphic_evk4", device.serial or "", f"{' '.join(kind)}, USB", device.error or "")
        for device in listed
        if device.name == package.Name.PROPHESEE_EVK4
    )


class NeuromorphicEvk4(UsbCameraDriver):
    """An ``EventCamera`` behind ``neuromorphic_drivers``; ``serial`` None accepts any camera.

    ``device`` is open and provides raw bytes; ``utc_now`` is for the header of a recording.
    """

    def __init__(
        self,
        device: Any,
        package: Any,
        *,
        serial: str | None,
        clock: Clock,
        utc_now: Callable[[], datetime],
    ) -> None:
        super().__init__(serial=serial, clock=clock)
        self._device = device
        self._package = package
        self._utc_now = utc_now
        self._has_measured = False

    @classmethod
    def open(
        cls, *, serial: str | None = None, clock: Clock, utc_now: Callable[[], datetime]
    ) -> NeuromorphicEvk4:
        """Open a camera; ``serial`` None opens the first one found.

        Raises `CameraNotFound` if there is no such camera, or no permission to use it; `CameraBusy` if another process
        of this bench has locked it (with a serial number given, the camera has not been touched); `WrongDevice` if
        another camera answers; `CameraSettingRefused` if the camera is connected by USB 2.
        """
        return cls(None, import_package(), serial=serial, clock=clock, utc_now=utc_now).open_device()

    def _opened(self) -> Any:
        """Open the package's device with its trigger input off. Raises CameraNotFound."""
        serial = self._serial
        configuration = self._package.prophesee_evk4.Configuration(enable_external_trigger=False)
        try:
            return self._package.open(configuration, iterator_timeout=POLL_S, raw=True, serial=serial)
        except RuntimeError as error:
            seen = ""
            with suppress(CameraError):
                seen = ", ".join(
                    (camera.serial or "without serial number")
                    + (f" ({camera.trouble})" if camera.trouble else "")
                    for camera in discover()
                )
            raise CameraNotFound(
                f"Cannot open {f'camera {serial}' if serial else 'any camera'} ({error}); "
                f"connected EVK4: {seen or 'none'}.",
                remedy="Check the camera's cable and power and the serial number in the station file; on Linux, run "
                "neuromorphic-drivers-install-udev-rules once.",
            ) from error

    def identify(self) -> CameraIdentity:
        """Read serial number and size from the camera; the package does not read the firmware's version.

        Raises `WrongDevice` if the serial number differs from the one given when the camera was opened.
        """
        try:
            serial, size = str(self._device.serial()), self._device.properties()
        except RuntimeError as error:
            raise self._lost(error) from error
        # The package may remember the serial number: only a measurement shows that the camera is still there.
        measured = self.temperature_c() is not None
        if self._has_measured and not measured:
            raise self._lost("it does not answer")
        self._has_measured = measured
        maker, model = only_camera_kind() or _UNKNOWN_KIND
        identity = CameraIdentity(
            maker=maker,
            model=model,
            sensor="IMX636",
            serial=serial,
            firmware="",
            width=int(size.width),
            height=int(size.height),
            link_mbit_s=only_camera_mbit_s(),
        )
        return self._require_serial(identity)

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set all biases (factory values where none is named) and the trigger input; the rate limiter stays off.

        Returns what was sent: the package cannot read it back. A bias that does not exist or is outside its range, or a
        region of interest, is refused.
        """
        refuse_roi(settings, self._where)
        biases = {name: settings.biases.get(name, 0) for name in BIASES}
        refuse_unknown_biases(settings, BIASES, self._where)
        evk4 = self._package.prophesee_evk4
        try:
            for name, (lowest, highest) in self.bias_ranges().items():
                check_bias(name, biases[name], lowest, highest, self._where)
            values = {name.removeprefix("bias_"): value for name, value in biases.items()}
            self._device.update_configuration(
                evk4.Configuration(
                    biases=evk4.Biases(**values),
                    enable_external_trigger=settings.trigger_in,
                    rate_limiter=None,
                )
            )
        except RuntimeError as error:
            raise self._lost(error) from error
        return CameraSettings(biases, settings.trigger_in)

    def bias_ranges(self) -> Mapping[str, tuple[int, int]]:
        """See `StatesBiasRanges.bias_ranges`."""
        bounds = self._device.biases_bounds()
        bounds_of = {name: getattr(bounds, name.removeprefix("bias_")) for name in BIASES}
        return {name: (int(bound.minimum), int(bound.maximum)) for name, bound in bounds_of.items()}

    def filters(self) -> Mapping[str, bool]:
        """Return the rate controller "erc", the package's only filter: ``open`` and ``apply`` leave it off."""
        return {"erc": False}

    def temperature_c(self) -> float | None:
        """See `EventCamera.temperature_c`."""
        return self._measured("temperature_celsius")

    def record(self, path: Path, duration_s: float) -> RecordingFacts:
        """Record into a new RAW file at least ``duration_s`` on the sensor's clock; see `EventCamera.record`.

        Packets that the computer lost are in ``gaps``. The ``biases`` are empty, because the package cannot read them
        back. However the recording ends, what was recorded before is kept.
        """
        self._begin(duration_s)
        camera = self.identify()
        stream = PacketStream(self._device, self._lost)
        header, size = render_header(camera, self._utc_now()), (camera.width, camera.height)
        recorded = self.record_words(stream, path, header, size, duration_s)
        return recording_facts(
            camera,
            recorded,
            biases={},
            filters=self.filters(),
            temperature_c=self.temperature_c(),
            illumination_lux=self._measured("illuminance"),
            losses=stream.losses,
        )

    def close(self) -> None:
        """See `EventCamera.close`."""
        try:
            if self._device is not None:
                self._device.close()
        finally:
            if self._lock is not None:
                self._lock.release()

    @property
    def _where(self) -> str:
        return f"camera {self._serial or 'EVK4'}"

    def _measured(self, call: str) -> float | None:
        try:
            return float(getattr(self._device, call)())
        except RuntimeError:  # the package's sign of a failed measurement
            return None

    def _lost(self, error: Exception | str) -> CameraLost:
        return connection_lost(str(error), self._where)


class PacketStream:
    """Raw packets from the moment of ``start`` on, beginning with a TIME_HIGH word."""

    def __init__(self, device: Any, lost: Callable[[Exception], CameraLost]) -> None:
        self._device = device
        self._lost = lost
        self._fresh = False
        self._begun = False
        self._rest = b""
        self._dropped = 0
        self.losses: list[str] = []

    def start(self) -> None:
        """Drop what the device has kept so far."""
        try:
            self._device.clear_backlog(0)
        except RuntimeError as error:
            raise self._lost(error) from error

    def next_words(self) -> bytes | None:
        """Return the whole words of the next packet; None if it has none."""
        try:
            status, packet = next(self._device)
        except StopIteration:
            return b""
        except RuntimeError as error:
            raise self._lost(error) from error
        if status.ring is None or not packet:
            return None
        if not self._fresh:
            self._fresh, self._dropped = True, status.ring.dropped_packets
            return None
        data = self._rest + bytes(packet)
        whole = len(data) // 2 * 2
        start = 0 if self._begun else first_time_high(np.frombuffer(data[:whole], "<u2"))
        self._rest = data[whole:]
        if start is None:
            return None
        self._note_losses(status.ring, after=2 * start - 1 if self._begun else 2 * start)
        self._begun = True
        return data[2 * start : whole] or None

    def stop(self, *, hurry: bool) -> None:
        """Do nothing: the device streams always, and the next ``start`` drops what has queued up."""

    def _note_losses(self, ring: Any, *, after: int) -> None:
        """Keep a message about packets that the ring lost, except those before the recording."""
        lost = [index for index in ring.overflow_indices or () if index > after]
        if lost or ring.dropped_packets > self._dropped:
            self.losses.append(f"The computer lost USB packets before {ring.system_time:.6f} s (UNIX time).")
        self._dropped = ring.dropped_packets


def import_package() -> Any:
    """Import ``neuromorphic_drivers``. Raises CameraSoftwareMissing."""
    try:
        return importlib.import_module("neuromorphic_drivers")
    except ImportError as error:
        raise CameraSoftwareMissing(
            f"The package neuromorphic-drivers cannot be imported ({error}).",
            remedy="Install it with: pip install 'starbench[evk4]'",
        ) from error
