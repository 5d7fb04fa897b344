"""Build requests and parse replies of Zaber's ASCII protocol: checksums, warning flags, refusals. Sends nothing.

A request is ``/device axis id words:LRC LF``, its reply ``@device axis id OK|RJ BUSY|IDLE flag data:LRC CR LF``.
Alerts (``!``) and information lines (``#``) are unsolicited. This driver always sends a message id and a checksum, and
takes no reply without them: without a checksum, a garbled position would go unnoticed. Controllers come from the
factory without checksums in their replies, so the driver switches these on.

Source: "Zaber ASCII Protocol Manual", https://www.zaber.com/protocol-manual, sections on message formats, message
checksums and warning flags.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from drivers.errors import ReplyGarbled

UNREFERENCED = frozenset({"WR", "WH"})
"""Flags of an axis that has no reference, or whose calibration is off until it is homed."""
INTERRUPTED = frozenset({"NI", "NC"})
"""Flags of a move that another command or a knob has interrupted."""

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
"""Meanings of the warning flags. F: fault, the controller acted; W: warning; N: note."""

_STOPPING_WARNINGS = frozenset({"WL", "WM"})

REFUSALS = {
    "AGAIN": "the device is not ready for this command yet",
    "BADAXIS": "no such axis",
    "BADCOMMAND": "unknown command",
    "BADDATA": "the value is out of range",
    "BADMESSAGEID": "invalid message id",
    "DEVICEONLY": "this command is for the device, not for an axis",
    "DRIVERDISABLED": "the motor driver is off",
    "FULL": "no room left in the device",
    "INACTIVE": "the axis is inactive",
    "LOCKSTEP": "the axis belongs to a lockstep group",
    "NOACCESS": "a higher access level is needed",
    "PARKED": "the axis is parked",
    "STATUSBUSY": "the axis is moving",
}
"""Meanings of the reasons for which a command is rejected."""

REMEDIES = {
    "LOCKSTEP": "Dissolve the group with the maker's software ('lockstep 1 setup disable').",
    "NOACCESS": "Raise the level with the maker's software ('set system.access 2').",
    "PARKED": "Make sure that nobody has moved the axis, then unpark it ('tools parking unpark').",
}
"""What helps against some of these reasons."""

_REPLY = re.compile(
    rb"@(?P<device>\d\d) (?P<axis>\d) (?P<id>\d\d) (?P<verdict>OK|RJ) (?P<state>BUSY|IDLE)"
    rb" (?P<flag>[A-Z][A-Z]|--) (?P<data>[ -9;-~]+)(?::(?P<lrc>[0-9A-F]{2}))?\r\n"
)
_UNSOLICITED = re.compile(rb"[!#]\d\d \d [ -9;-~]+(?::(?P<lrc>[0-9A-F]{2}))?\r\n")


@dataclass(frozen=True)
class Reply:
    """A device's reply to one request."""

    device: int
    axis: int
    message_id: int
    accepted: bool  # Whether the device accepts the request
    busy: bool  # Whether the axis moves
    flag: str  # The most urgent warning flag, or "--"
    data: str  # The value asked for, or the reason of a refusal


def checksum(body: bytes) -> int:
    """Return the LRC (longitudinal redundancy check), 0 to 255: two's complement of the sum of the bytes.

    ``body`` is all bytes between the first one of the message and the colon.

    >>> f"{checksum(b'1 1 03 home'):02X}"
    '32'
    """
    return -sum(body) & 0xFF


def request(device: int, axis: int, message_id: int, words: str = "") -> bytes:
    r"""Return the bytes of a request: device 0 for all, axis 0 for the device, message id 0 to 99, words or none.

    >>> request(1, 1, 5, "move abs 50000")
    b'/1 1 05 move abs 50000:B7\n'
    >>> request(1, 1, 4)
    b'/1 1 04:FA\n'
    """
    body = " ".join(filter(None, [f"{device} {axis} {message_id:02d}", words])).encode("ascii")
    return b"/" + body + f":{checksum(body):02X}\n".encode("ascii")


def parse_reply(line: bytes, where: str = "", *, without_checksum: bool = False) -> Reply:
    r"""Parse a reply, which must have a correct checksum, or ``without_checksum`` may have none.

    >>> parse_reply(b"@01 0 00 OK IDLE WR 0:BE\r\n").flag
    'WR'
    """
    match = _REPLY.fullmatch(line)
    if match is None:
        raise ReplyGarbled(
            f"not a reply of the protocol: {line[:80]!r}.",
            where=where,
            remedy="Check the cable and the port.",
        )
    if match["lrc"] is not None:
        _check_sum(line, match, where)
    elif not without_checksum:
        raise ReplyGarbled(
            f"a reply without a checksum: {line[:80]!r}.",
            where=where,
            remedy="Another program has switched checksums off since the stage was opened. Close that program.",
        )
    return Reply(
        device=int(match["device"]),
        axis=int(match["axis"]),
        message_id=int(match["id"]),
        accepted=match["verdict"] == b"OK",
        busy=match["state"] == b"BUSY",
        flag=match["flag"].decode("ascii"),
        data=match["data"].decode("ascii"),
    )


def is_unsolicited(line: bytes, where: str = "") -> bool:
    """Return whether a line is an alert or an information line: no answer to a request. A checksum is checked."""
    match = _UNSOLICITED.fullmatch(line)
    if match is not None and match["lrc"] is not None:
        _check_sum(line, match, where)
    return match is not None


def parse_flags(data: str, where: str = "") -> tuple[str, ...]:
    """Parse the data of a reply to ``warnings``: a count, then that many flags.

    >>> parse_flags("02 WR NI")
    ('WR', 'NI')
    """
    count, *flags = data.split(" ")
    if not re.fullmatch(r"\d\d( [A-Z]{2})*", data) or int(count) != len(flags):
        raise ReplyGarbled(
            f"not a list of warning flags: {data!r}.", where=where, remedy="Look into the wire log."
        )
    return tuple(flags)


def is_fault(flag: str) -> bool:
    """Return whether an axis with this flag must not be moved, and its last move has failed.

    True for faults, an unexpected limit and a displacement at rest.
    """
    return flag.startswith("F") or flag in _STOPPING_WARNINGS


def is_informational(flag: str) -> bool:
    """Return whether a flag reports a past event (a note, except manual control), not a present state.

    >>> is_informational("NI"), is_informational("NC"), is_informational("WT")
    (True, False, False)
    """
    return flag.startswith("N") and flag != "NC"


def describe_flag(flag: str) -> str:
    """Return the meaning of a flag.

    >>> describe_flag("FS")
    'stalled and stopped (FS)'
    """
    return f"{FLAGS.get(flag, 'unknown warning')} ({flag})"


def _check_sum(line: bytes, match: re.Match[bytes], where: str) -> None:
    body = line[1 : match.start("lrc") - 1]
    if checksum(body) != int(match["lrc"], 16):
        raise ReplyGarbled(f"wrong checksum in {line[:80]!r}.", where=where, remedy="Check the cable.")
