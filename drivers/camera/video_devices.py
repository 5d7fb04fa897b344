"""List the video devices of this computer, with the serial numbers of their cameras. No device is opened.

OpenCV identifies cameras by numbers that change from one start to the next, and has no serial numbers. Linux has
both: it names a device after its camera (``/dev/v4l/by-id``), and states the serial number that the camera gave on USB.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from drivers.camera import FoundCamera

DEV: Final = Path("/dev")
"""Folder of the device files."""
SYSTEM: Final = Path("/sys/class/video4linux")
"""Folder in which Linux lists its video devices."""


def device_path(source: str, dev: Path = DEV) -> Path | None:
    """Return the device file that a source stands for.

    source: ``0``, ``/dev/video0``, a name by id, or something that is no device.
    Returns: The device file; None for a source that is no device.

    Examples
    --------
    >>> device_path("0").as_posix(), device_path("rtsp://camera/1"), device_path("pose_%03d.png")
    ('/dev/video0', None, None)
    """
    if source.isdecimal():
        return dev / f"video{int(source)}"
    path = Path(source)
    return path.resolve() if path.is_absolute() and path.is_relative_to(dev) else None


def usb_serial(device: Path, system: Path = SYSTEM) -> str:
    """Read the serial number of the USB device that a video device belongs to.

    Returns: The serial number; empty if the device has none.
    """
    place = (system / device.name / "device").resolve()
    for folder in (place, *place.parents):
        if (folder / "idVendor").is_file():  # the USB device itself; below it are its interfaces
            try:
                return (folder / "serial").read_text(encoding="utf-8", errors="replace").strip()
            except OSError:
                return ""
    return ""


def is_capture_device(device: Path, system: Path = SYSTEM) -> bool:
    """Return whether a video device is the first of its camera; the others carry metadata, which OpenCV cannot read.

    Returns: True also if the system does not state it.
    """
    try:
        return (system / device.name / "index").read_text(encoding="ascii").strip() == "0"
    except OSError:
        return True


def video_devices(dev: Path = DEV, system: Path = SYSTEM) -> list[FoundCamera]:
    """List the video devices as frame cameras."""
    by_id = dev / "v4l" / "by-id"
    names = {link.resolve(): link for link in by_id.iterdir()} if by_id.is_dir() else {}
    devices = [path for path in sorted(dev.glob("video[0-9]*")) if is_capture_device(path, system)]
    return [
        FoundCamera(
            driver="opencv",
            serial=usb_serial(device, system),
            description=f"video device {device}",
            source=str(names.get(device.resolve(), device)),
        )
        for device in devices
    ]
