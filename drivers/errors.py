"""Every error that a driver raises. Each says what is wrong, where, and what the operator should do.

DriverError
├── PortError                 the line to the device
│   ├── PortNotFound          no such port
│   ├── PortBusy              another program holds it
│   ├── PortDenied            no permission
│   └── PortLost              it was open and is gone: unplugged, powered off, closed by the other end
├── ReplyError                a reply that cannot be used
│   ├── ReplyTimeout          no (complete) reply before the deadline
│   └── ReplyGarbled          a reply that breaks the protocol: checksum, id, address, form
├── DeviceRefused             a well-formed refusal of a command
├── WrongDevice               another device (serial number, model) than the station file names
├── StageError
│   ├── NotHomed              an absolute move of an axis without a reference
│   ├── OutsideLimits         a target or setting outside the limits; nothing was sent
│   ├── MoveFailed            stalled, hit a limit, stopped short, interrupted, slipped
│   └── MoveTimeout           still busy after the deadline for that distance and speed
├── LightError
│   ├── SettingRefused        the light did not accept a setting, or changed it
│   └── LightFault            the light does not do what it was set to do
├── CameraError
│   ├── CameraNotFound        no camera, or none with that serial number
│   ├── CameraBusy            another process holds it
│   ├── CameraLost            it was connected and is gone
│   ├── CameraSettingRefused  a bias, filter or region that the camera did not accept
│   ├── CameraSoftwareMissing the vendor's software is not installed
│   └── RecordingFailed       a recording that could not be completed; the partial file is named
└── RecordingFileError        a recording's file that cannot be read
    ├── NotARecording         no RAW header, or not EVT3
    └── RecordingCorrupt      malformed data at a byte offset
"""

from __future__ import annotations


class DriverError(Exception):
    """Base of all errors of drivers: what is wrong, where, and what to do."""

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = _one_stop(what)
        self.where = where
        self.remedy = remedy
        place = f"{where}: " if where else ""
        advice = f" {remedy}" if remedy else ""
        super().__init__(f"{place}{self.what}{advice}")


def _one_stop(text: str) -> str:
    """Return a text with one full stop at its end, where it has two because it ends with a quoted sentence."""
    return text[:-1] if text.endswith("..") and not text.endswith("...") else text


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
    """The device's reply cannot be used."""


class ReplyTimeout(ReplyError):
    """No complete reply came before the deadline.

    ``late_s`` is how late a busy computer was during the wait, s; 0 where the computer is not to blame.
    """

    def __init__(self, what: str, *, where: str = "", remedy: str = "", late_s: float = 0.0) -> None:
        self.late_s = late_s
        super().__init__(what, where=where, remedy=remedy)


class ReplyGarbled(ReplyError):
    """A reply breaks the protocol."""


class DeviceRefused(DriverError):
    """The device refused a command."""


class WrongDevice(DriverError):
    """The device that answers is not the one that the station file names."""


class StageError(DriverError):
    """A stage cannot do, or did not do, what it was told to do."""


class NotHomed(StageError):
    """An axis without a reference cannot move to an absolute angle."""


class OutsideLimits(StageError):
    """A target or a setting lies outside the limits; nothing was sent."""


class MoveFailed(StageError):
    """A move did not end at its target."""


class MoveTimeout(StageError):
    """A move had not ended by its deadline."""


class LightError(DriverError):
    """A light cannot do, or did not do, what it was told to do."""


class SettingRefused(LightError):
    """The light did not accept a setting, or changed its value."""


class LightFault(LightError):
    """The light does not do what it was set to do."""


class CameraError(DriverError):
    """A camera cannot do, or did not do, what it was told to do."""


class CameraNotFound(CameraError):
    """There is no camera, or none with that serial number."""


class CameraBusy(CameraError):
    """Another process holds the camera."""


class CameraLost(CameraError):
    """The camera was connected and is gone."""


class CameraSettingRefused(CameraError):
    """The camera did not accept a bias, a filter or a region."""


class CameraSoftwareMissing(CameraError):
    """The vendor's software is not installed."""


class RecordingFailed(CameraError):
    """A recording could not be completed."""


class RecordingFileError(DriverError):
    """A recording's file cannot be read."""


class NotARecording(RecordingFileError):
    """A file has no RAW header, or holds no EVT3 data."""


class UnreadableEvents(NotARecording):
    """What a file holds is no list of events, or not all of it is there."""

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        again = "Copy the file again. If that does not help, write it again with the program that made it."
        super().__init__(what, where=where, remedy=remedy or again)


class RecordingCorrupt(RecordingFileError):
    """Data are malformed; ``offset`` is the position of the first malformed word in the file, bytes."""

    def __init__(self, what: str, *, offset: int, where: str = "", remedy: str = "") -> None:
        self.offset = offset
        super().__init__(f"{what.removesuffix('.')} (byte {offset}).", where=where, remedy=remedy)
