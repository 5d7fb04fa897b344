"""How a run left each device: what it answered when it was made safe."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

DeviceName = Literal["stage", "light", "camera"]
EndState = Literal["confirmed safe", "not confirmed", "never opened"]

DEVICES: Final[tuple[DeviceName, ...]] = ("stage", "light", "camera")
NOT_ASKED: Final = "nothing states how it was left"
"""What is known of a device if no line of the journal states more."""
NO_END: Final = "killed, power lost or disk full"
"""Why a journal has no line that ends the run, as far as can be known."""
_MAY_BE: Final[Mapping[DeviceName, str]] = {
    "stage": "The stage may be moving.",
    "light": "The light may be on.",
    "camera": "",
}
_UNTOUCHED: Final[Mapping[DeviceName, str]] = {
    "stage": "This run did not move it.",
    "light": "This run did not switch it. The light may be on.",
    "camera": "",
}


@dataclass(frozen=True)
class DeviceEnd:
    """How one device was left; the journal and JSON hold these fields."""

    device: DeviceName
    state: EndState
    said: str = ""  # What it answered, or why it did not; empty if it was never opened

    @property
    def text(self) -> str:
        """The state as a line for people; it says what may be the case where nothing was confirmed."""
        ending = f": {self.said}" if self.said else ""
        stop = "" if ending.endswith((".", "!")) else "."
        return f"{self.device}: {self.state}{ending}{stop}{f' {self.advice}' if self.advice else ''}"

    @property
    def advice(self) -> str:
        """What may be the case where nothing was confirmed; empty if the device confirmed that it is safe."""
        if self.state == "confirmed safe":
            return ""
        return (_MAY_BE if self.state == "not confirmed" else _UNTOUCHED)[self.device]


def all_ends(known: Sequence[DeviceEnd]) -> list[DeviceEnd]:
    """Add the devices that were never opened: one each for stage, light and camera, in this order."""
    by_name = {end.device: end for end in known}
    return [by_name.get(name, DeviceEnd(name, "never opened")) for name in DEVICES]


def lost_ends(why: str) -> list[DeviceEnd]:
    """Return the states of devices that cannot be asked any more: none is confirmed."""
    return [DeviceEnd(name, "not confirmed", why) for name in DEVICES]


def unsafe_devices(ends: Iterable[DeviceEnd]) -> list[str]:
    """Return a sentence each for stage and light if it did not confirm that it is safe; a camera needs none."""
    unsure = [end.said for end in ends if end.state == "not confirmed" and end.device != "camera"]
    return list(dict.fromkeys(unsure))
