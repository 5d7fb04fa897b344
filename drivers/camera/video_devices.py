"""Video devices of this computer as its system lists them: which there are, and their serial numbers.

OpenCV knows cameras by numbers that change from one start to the next, and no serial numbers. Linux knows both: it
names a device by what it is (``/dev/v4l/by-id``), and tells the serial number that the camera gave on USB. Opens
no device.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from drivers.camera import FoundCamera

DEV: Final = Path("/dev")
SYSTEM: Final = Path("/sys/class/video4linux")


def device_path(source: str, dev: Path = DEV) -> Path | None:
    """Give the device file that a source stands for: ``0``, ``/dev/video0`` or a name by id; None for no device.

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
    """Ask the system for a camera's serial number: that of the USB device it belongs to; empty when it has none."""
    place = (system / device.name / "device").resolve()
    for folder in (place, *place.parents):
        if (folder / "idVendor").is_file():  # the USB device itself; below it are its interfaces
            try:
                return (folder / "serial").read_text(encoding="utf-8", errors="replace").strip()
            except OSError:
                return ""
    return ""


def is_capture_device(device: Path, system: Path = SYSTEM) -> bool:
    """Whether a device is a camera's first one; its further ones carry metadata, which OpenCV cannot read."""
    try:
        return (system / device.name / "index").read_text(encoding="ascii").strip() == "0"
    except OSError:
        return True


def video_devices(dev: Path = DEV, system: Path = SYSTEM) -> list[FoundCamera]:
    """List them as frame cameras, each by the name that a station file should call it."""
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
