"""Every error a driver raises; each says what is wrong, where, and what the operator should do.

DriverError
├── PortError                 the line to the device
│   ├── PortNotFound          no such port
│   ├── PortBusy              another program holds it
│   ├── PortDenied            no permission
│   └── PortLost              it was there and is gone: unplugged, powered off, closed by the peer
├── ReplyError                the device and we do not understand each other
│   ├── ReplyTimeout          no (complete) answer before the deadline
│   └── ReplyGarbled          an answer that breaks the protocol: checksum, id, address, form
├── DeviceRefused             a well-formed refusal of a command
├── WrongDevice               another device (serial number, model) than the station file names
├── StageError
│   ├── NotHomed              absolute motion asked of an axis without a reference
│   ├── OutsideLimits         a target outside the soft limits; nothing was sent
│   ├── MoveFailed            stalled, hit a limit, stopped short, interrupted, slipped
│   └── MoveTimeout           still busy after the deadline for that distance and speed
├── LightError
│   ├── SettingRefused        the light did not take, or clipped, a setting
│   └── LightFault            lamp open, over-temperature, output lost
├── CameraError
│   ├── CameraNotFound        no camera, or none with that serial number
│   ├── CameraBusy            another process holds it
│   ├── CameraLost            it went away
│   ├── CameraSettingRefused  a bias, filter or region it did not take
│   ├── CameraSoftwareMissing the vendor's software is not installed
│   └── RecordingFailed       a recording that could not be completed; the partial file is named
└── RecordingFileError        a RAW file
    ├── NotARecording         no RAW header, or not EVT3
    └── RecordingCorrupt      malformed at a byte offset
"""

from __future__ import annotations


class DriverError(Exception):
    """What is wrong, where, and what to do about it.

    Parameters
    ----------
    what
        One sentence: what is wrong.
    where
        The device, port or file it concerns.
    remedy
        One sentence: what the operator should do.
    """

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = what
        self.where = where
        self.remedy = remedy
        place = f"{where}: " if where else ""
        advice = f" {remedy}" if remedy else ""
        super().__init__(f"{place}{what}{advice}")


class PortError(DriverError):
    """The line to a device cannot be used."""


class PortNotFound(PortError):
    """No such port."""


class PortBusy(PortError):
    """Another program holds the port."""


class PortDenied(PortError):
    """No permission to open the port."""


class PortLost(PortError):
    """The port was open and is gone."""


class ReplyError(DriverError):
    """The device's answer cannot be used."""


class ReplyTimeout(ReplyError):
    """No complete answer before the deadline."""


class ReplyGarbled(ReplyError):
    """An answer that breaks the protocol."""


class DeviceRefused(DriverError):
    """The device refused a command in good form."""


class WrongDevice(DriverError):
    """Another device answers than the one the station file names."""


class StageError(DriverError):
    """A stage cannot do, or did not do, what was asked."""


class NotHomed(StageError):
    """Absolute motion was asked of an axis without a reference."""


class OutsideLimits(StageError):
    """A target outside the soft limits; nothing was sent."""


class MoveFailed(StageError):
    """A move ended elsewhere than at its target."""


class MoveTimeout(StageError):
    """A move was still going on after its deadline."""


class LightError(DriverError):
    """A light cannot do, or did not do, what was asked."""


class SettingRefused(LightError):
    """The light did not take a setting, or took another value."""


class LightFault(LightError):
    """The light reports a fault."""


class CameraError(DriverError):
    """A camera cannot do, or did not do, what was asked."""


class CameraNotFound(CameraError):
    """No camera, or none with that serial number."""


class CameraBusy(CameraError):
    """Another process holds the camera."""


class CameraLost(CameraError):
    """The camera went away."""


class CameraSettingRefused(CameraError):
    """A bias, filter or region the camera did not take."""


class CameraSoftwareMissing(CameraError):
    """The vendor's software is not installed."""


class RecordingFailed(CameraError):
    """A recording could not be completed."""


class RecordingFileError(DriverError):
    """A recording's file cannot be read."""


class NotARecording(RecordingFileError):
    """No RAW header, or not EVT3."""


class RecordingCorrupt(RecordingFileError):
    """Malformed data at a byte offset.

    Parameters
    ----------
    offset
        Byte offset in the file of the first malformed word.
    """

    def __init__(self, what: str, *, offset: int, where: str = "", remedy: str = "") -> None:
        self.offset = offset
        super().__init__(f"{what} (byte {offset})", where=where, remedy=remedy)
