"""Knows the words of Zaber's ASCII protocol: requests, replies, checksums, flags. Sends nothing.

A request is ``/device axis id words:LRC LF``, its reply
``@device axis id OK|RJ BUSY|IDLE flag data:LRC CR LF``.
Unsolicited are alerts (``!``) and information lines (``#``). We always send an id and a checksum, and take
no reply without them: a controller that leaves the checksum out can garble a position unnoticed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from drivers.errors import ReplyGarbled

UNREFERENCED = frozenset({"WR", "WH"})
"""Flags of an axis whose counter means nothing yet, or whose calibration is off until it is homed."""
INTERRUPTED = frozenset({"NI", "NC"})
"""Flags that mean that somebody else took the move over."""

FLAGS = {
    "FF": "critical system error",
    "FH": "emergency stop",
    "FN": "peripheral not supported",
    "FZ": "inactive axis, or peripheral changed",
    "FV": "supply voltage or current out of range, driver off",
    "FO": "driver off",
    "FD": "driver off by itself",
    "FC": "inrush current too high",
    "FM": "motor too hot",
    "FQ": "encoder error",
    "FI": "index error",
    "FA": "analogue encoder out of step",
    "FR": "overdriven for too long",
    "FS": "stalled and stopped",
    "FE": "limit sensor error",
    "FT": "twisted beyond tolerance",
    "FB": "stream bounds exceeded",
    "FP": "path deviation",
    "FK": "interpolated path deviation",
    "WR": "no reference position",
    "WH": "not homed",
    "WL": "unexpected limit reached",
    "WM": "displaced while standing",
    "WS": "stalled, with recovery",
    "WP": "invalid calibration type",
    "WV": "supply voltage out of range",
    "WT": "controller too hot",
    "NC": "under manual control",
    "NI": "interrupted by another command",
    "NU": "setting update pending",
    "NR": "a value was rounded",
    "NT": "a value was cut to its range",
    "ND": "stream discontinuous",
    "NJ": "joystick calibrating",
    "NB": "movement limited by bounds",
}
"""Warning flags in plain words. F: fault, the driver acted; W: warning; N: note."""

_STOPPING_WARNINGS = frozenset({"WL", "WM"})

REFUSALS = {
    "AGAIN": "the device is not ready for this command yet",
    "BADAXIS": "it has no such axis",
    "BADCOMMAND": "it does not know this command",
    "BADDATA": "the value is out of its range",
    "BADMESSAGEID": "it does not take this message id",
    "DEVICEONLY": "this command is not one of an axis",
    "DRIVERDISABLED": "the motor driver is off",
    "FULL": "it has no room left",
    "INACTIVE": "the axis is inactive",
    "LOCKSTEP": "the axis belongs to a lockstep group",
    "NOACCESS": "it needs a higher access level",
    "PARKED": "the axis is parked",
    "STATUSBUSY": "the axis is moving",
}
"""Reasons of a rejected command in plain words."""

_REPLY = re.compile(
    rb"@(?P<device>\d\d) (?P<axis>\d) (?P<id>\d\d) (?P<verdict>OK|RJ) (?P<state>BUSY|IDLE)"
    rb" (?P<flag>[A-Z][A-Z]|--) (?P<data>[ -9;-~]+):(?P<lrc>[0-9A-F]{2})\r\n"
)
_UNSOLICITED = re.compile(
    rb"(?P<kind>[!#])(?P<device>\d\d) (?P<axis>\d) (?P<text>[ -9;-~]+):(?P<lrc>[0-9A-F]{2})\r\n"
)


@dataclass(frozen=True)
class Reply:
    """A device's answer to one request."""

    device: int
    axis: int
    message_id: int
    accepted: bool
    busy: bool
    flag: str
    """The most urgent warning flag, or "--"."""
    data: str


@dataclass(frozen=True)
class Unsolicited:
    """A line nobody asked for: an alert (kind "!") or an information line (kind "#")."""

    kind: str
    device: int
    axis: int
    text: str


def checksum(body: bytes) -> int:
    """Return the LRC: two's complement of the sum of all bytes between the first one and the colon.

    >>> f"{checksum(b'1 1 03 home'):02X}"
    '32'
    """
    return -sum(body) & 0xFF


def request(device: int, axis: int, message_id: int, words: str = "") -> bytes:
    r"""Return a request's bytes.

    >>> request(1, 1, 5, "move abs 50000")
    b'/1 1 05 move abs 50000:B7\n'
    >>> request(1, 1, 4)
    b'/1 1 04:FA\n'
    """
    body = " ".join(filter(None, [f"{device} {axis} {message_id:02d}", words])).encode("ascii")
    return b"/" + body + f":{checksum(body):02X}\n".encode("ascii")


def parse_reply(line: bytes, where: str = "") -> Reply:
    r"""Understand a reply line, its CR LF included.

    Raises ReplyGarbled for anything else, a missing or wrong checksum included; ``where`` is for its message.

    >>> parse_reply(b"@01 0 00 OK IDLE WR 0:BE\r\n").flag
    'WR'
    """
    match = _REPLY.fullmatch(line)
    if match is None:
        raise ReplyGarbled(
            f"not a reply of the protocol: {line[:80]!r}.",
            where=where,
            remedy="If checksums are missing, send the controller 'set comm.checksum 1' once.",
        )
    _check_sum(line, match, where)
    return Reply(
        device=int(match["device"]),
        axis=int(match["axis"]),
        message_id=int(match["id"]),
        accepted=match["verdict"] == b"OK",
        busy=match["state"] == b"BUSY",
        flag=match["flag"].decode("ascii"),
        data=match["data"].decode("ascii"),
    )


def parse_unsolicited(line: bytes, where: str = "") -> Unsolicited | None:
    r"""Understand an alert or an information line; None for any other line.

    Raises ReplyGarbled when its checksum is wrong.
    """
    match = _UNSOLICITED.fullmatch(line)
    if match is None:
        return None
    _check_sum(line, match, where)
    return Unsolicited(
        kind=match["kind"].decode("ascii"),
        device=int(match["device"]),
        axis=int(match["axis"]),
        text=match["text"].decode("ascii"),
    )


def parse_flags(data: str, where: str = "") -> tuple[str, ...]:
    """Understand the data of a ``warnings`` reply: a count, then that many flags.

    Raises ReplyGarbled.

    >>> parse_flags("02 WR NI")
    ('WR', 'NI')
    """
    count, *flags = data.split(" ")
    if not re.fullmatch(r"\d\d( [A-Z]{2})*", data) or int(count) != len(flags):
        raise ReplyGarbled(f"not a list of warning flags: {data!r}.", where=where, remedy="See the wire log.")
    return tuple(flags)


def is_fault(flag: str) -> bool:
    """Whether an axis that raises this flag must not be moved, and has not arrived anywhere."""
    return flag.startswith("F") or flag in _STOPPING_WARNINGS


def is_history(flag: str) -> bool:
    """Whether a flag tells what happened, not what is the matter now: a note, manual control aside.

    >>> is_history("NI"), is_history("NC"), is_history("WT")
    (True, False, False)
    """
    return flag.startswith("N") and flag != "NC"


def in_words(flag: str) -> str:
    """Return a flag in plain words.

    >>> in_words("FS")
    'stalled and stopped (FS)'
    """
    return f"{FLAGS.get(flag, 'unknown warning')} ({flag})"


def _check_sum(line: bytes, match: re.Match[bytes], where: str) -> None:
    body = line[1 : match.start("lrc") - 1]
    if checksum(body) != int(match["lrc"], 16):
        raise ReplyGarbled(f"wrong checksum in {line[:80]!r}.", where=where, remedy="Check the cable.")
