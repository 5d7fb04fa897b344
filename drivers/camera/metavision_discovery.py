"""Find cameras by the HAL of Metavision or OpenEB, and say why one cannot be opened.

The maker's software is imported here. It looks at each camera itself in order to list it.

The software writes causes that its errors leave out to the file descriptor of standard error itself, so Python's
``sys.stderr`` does not see them. What was written appears on standard error all the same, when the listening ends.
"""

from __future__ import annotations

import importlib
import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Final

from drivers.camera import FoundCamera
from drivers.camera.usb_permission import connected_cameras, unreadable_cameras
from drivers.errors import CameraError, CameraNotFound, CameraSoftwareMissing

_STDERR: Final = 2  # Descriptor of standard error
_LISTENING = threading.RLock()
_OLD_FIRMWARE: Final = re.compile(r"serial\s*(\S+)\s*is using an old firmware")
"""OpenEB 5.1.1, ``tz_libusb_board_command.cpp``: written once for each camera in a process, for firmware below 3.8."""

refused_firmware: set[str] = set()
OLDEST_FIRMWARE: Final = "3.8"
"""The maker's software refuses an EVK4 with an older firmware."""
_DENIED: Final = "LIBUSB_ERROR_ACCESS"
"""Word of the software on standard error for a camera that this user may not use."""
_BUSY: Final = "LIBUSB_ERROR_BUSY"
"""Word of the software for a camera that another program has opened."""
_PLUGINS: Final = "MV_HAL_PLUGIN_PATH"
"""Environment variable by which the software finds its plug-ins, one for each maker of cameras."""
_MUTE: Final = "LIBUSB_ERROR_TIMEOUT"
"""Word of the software for a camera that does not answer."""
_REPLUG: Final = "Pull the camera's cable, wait for 5 s, plug it in again, then resume the run."
_ENDED: Final = re.compile(r"Error (\w+): LibUSB connection error: \*\*UNKNOWN\*\*")
_ENDINGS: Final[Mapping[str, str]] = {
    "1": "error",
    "2": "timed out",
    "4": "stalled",
    "5": "the device is gone",
    "6": "the device sent too much",
}
"""States in which libusb ends a transfer; OpenEB tells them as errors without a name."""
_UPDATE: Final = "Update the camera's firmware with the maker's updater (support.prophesee.ai)"


@contextmanager
def listening() -> Iterator[list[str]]:
    """Listen to standard error during the block; `refused_firmware` then has what was said.

    What was said is there when the block has ended; nothing is heard if standard error is closed.
    """
    words: list[str] = []
    with _LISTENING, tempfile.TemporaryFile() as heard:
        with suppress(OSError, ValueError, AttributeError):
            sys.stderr.flush()
        try:
            kept = os.dup(_STDERR)
        except OSError:
            yield words
            return
        os.dup2(heard.fileno(), _STDERR)
        try:
            yield words
        finally:
            os.dup2(kept, _STDERR)
            os.close(kept)
            heard.seek(0)
            output = heard.read()
            words.append(output.decode(errors="replace"))
            refused_firmware.update(_OLD_FIRMWARE.findall(words[0]))
            with suppress(OSError):
                os.write(_STDERR, output)


def discover() -> tuple[FoundCamera, ...]:
    """List the cameras that the maker's software finds."""
    return _look()[0]


def _look() -> tuple[tuple[FoundCamera, ...], bool]:
    """List the cameras; return whether the software was denied one, too. Raises as `discover`."""
    hal = vendor_software()
    try:
        with listening() as heard:
            listed = list(hal.DeviceDiscovery.list_available_sources())
    except RuntimeError as error:
        if _MUTE in (reason := reason_of(error)):
            raise CameraError(
                f"A camera that is connected does not answer ({reason}).",
                where="metavision_hal",
                remedy=_REPLUG,
            ) from error
        raise CameraError(
            f"The software cannot list cameras ({reason_of(error)}).",
            where="metavision_hal",
            remedy=f"Check that its plugins are found ({_PLUGINS}), and that this user may use USB.",
        ) from error
    cameras = [
        FoundCamera(
            driver="metavision",
            serial=str(seen.serial),
            description=f"{seen.integrator_name}, {str(seen.connection).rsplit('.', 1)[-1]}, {seen.plugin_name}",
        )
        for seen in listed
    ]
    on_usb = connected_cameras()
    # An old one may have been unplugged since it was refused
    missing = on_usb is None or len(on_usb) > len(cameras)
    refused = sorted(refused_firmware - {camera.serial for camera in cameras}) if missing else []
    trouble = f"its firmware is older than {OLDEST_FIRMWARE}. {_UPDATE}."
    cameras += [FoundCamera("metavision", serial, "Prophesee", trouble) for serial in refused]
    return tuple(cameras), any(_DENIED in words for words in heard)


def not_opened(serial: str | None, reason: str) -> CameraNotFound:
    """Return the error of a camera (None: any) that cannot be opened, with its cause where one is known.

    ``reason`` is what the maker's software said, in brackets; empty if nothing.
    """
    camera = f"camera {serial}" if serial else "any camera"
    if _MUTE in reason:  # listing would wait for it again, 30 s
        return CameraNotFound(
            f"Cannot open {camera}: a camera that is connected does not answer{reason}.", remedy=_REPLUG
        )
    cameras, denied = _look()
    refused = [unusable for unusable in cameras if unusable.trouble and serial in {None, unusable.serial}]
    if refused:
        return CameraNotFound(
            f"Cannot open {camera}: the firmware of camera {refused[0].serial} is older than {OLDEST_FIRMWARE}, and the"
            " maker's software refuses it.",
            remedy=f"{_UPDATE}, then resume the run.",
        )
    seen = ", ".join(unusable.serial for unusable in cameras) or "none"
    hints = [] if cameras else unreadable_cameras() or _hints(denied=denied)
    if _BUSY in reason:
        hints = ["Another program uses it."]
    cable = "" if cameras or hints else "the camera's cable and power, "
    return CameraNotFound(
        f"Cannot open {camera}{reason}; the maker's software finds these cameras: {seen}."
        f"{''.join(f' {hint}' for hint in hints)}",
        remedy=f"Check {cable}the serial number in the station file, the udev rules, and that no other program uses the"
        " camera.",
    )


def _hints(*, denied: bool) -> list[str]:
    """Return why the software may find no camera."""
    if denied:
        text = f"A Prophesee camera is connected, but this user may not use it ({_DENIED}): install the udev rules"
        return [f"{text} of its maker (in OpenEB: hal_psee_plugins/resources/rules), then plug it in again."]
    return [
        f"A {name} is connected. The software does not find its plug-in ({_PLUGINS} must name the folder of"
        " hal_plugin_prophesee), or another program uses the camera."
        for name in connected_cameras() or ()
    ]


def stated(about: Mapping[str, Any], ending: str) -> str:
    """Return the camera's statement whose name ends so; empty if there is none."""
    return next((str(text) for name, text in about.items() if name.endswith(ending)), "")


def link_mbit_s(about: Mapping[str, Any]) -> int | None:
    """Return the speed of the USB connection, Mbit/s; None where it is not known: OpenEB then states 0."""
    speed = re.match(r"\d+", stated(about, " Speed"))
    return int(speed[0]) or None if speed is not None else None


def vendor_software() -> Any:
    """Import ``metavision_hal``."""
    try:
        return importlib.import_module("metavision_hal")
    except ImportError as error:
        raise CameraSoftwareMissing(
            f"The camera's software, metavision_hal, cannot be imported ({error}).",
            remedy="Install OpenEB or the Metavision SDK 5 (docs.prophesee.ai; not from PyPI) for the Python "
            "version that runs Starbench, and add its Python folder to PYTHONPATH.",
        ) from error


def reason_of(error: Exception) -> str:
    """Return the line of the maker's message, often framed and titled, that states the cause."""
    lines = [line.strip() for line in str(error).splitlines() if any(c.isalpha() for c in line)]
    reason = next(
        (line for line in lines if line.startswith("Error")), lines[0] if lines else "no reason given"
    )
    ended = _ENDED.fullmatch(reason)
    return f"the USB transfer ended: {_ENDINGS.get(ended[1], reason)}" if ended else reason
