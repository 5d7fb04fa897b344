"""Say why a device gives no reply, from what came before: its power and its cable are doubted only if nothing came."""

from __future__ import annotations

import re
from typing import Final, NamedTuple

ONE_AT_A_TIME: Final = " Many devices on a network serve one program: check that no other one is connected."
KEPT: Final = 200
"""Latest bytes of a line that are searched for a cause: a report and a prompt are shorter."""


class Cause(NamedTuple):
    """Why no reply comes, as the end of a sentence, and what to do."""

    what: str
    remedy: str


_CAUSES: Final = (
    (
        re.compile(rb"(?s)\|MPG:1(?!.*\|MPG:0)"),  # grblHAL's report; it takes no lines meanwhile
        Cause("a pendant (MPG) has the control of the board", "Give the control back at the pendant."),
    ),
    (
        re.compile(rb"port (?:is )?(?:already )?in use", re.IGNORECASE),  # ser2net
        Cause(
            "the device server says that its port is in use",
            "End the other program, perhaps on another computer, that is connected to it.",
        ),
    ),
    (
        re.compile(rb"(?:login|user ?name|password) ?:", re.IGNORECASE),
        Cause(
            "something asks for a login",
            "Name the port of the serial line in the station file, not that of a console, or switch the login off.",
        ),
    ),
)
ECHO_REMEDY: Final = "Switch the echo off: in an RS-485 adapter, or a FluidNC (Ctrl-L in a terminal)."
_ENDS: Final = {b"\r": "CR", b"\n": "LF"}


def known_cause(heard: bytes) -> Cause | None:
    """Return the cause that the latest bytes of a line tell; None if they tell none."""
    return next((cause for form, cause in _CAUSES if form.search(heard)), None)


def why_incomplete(unread: bytes, end: bytes) -> Cause:
    """Return what some bytes tell that are no whole reply; ``end`` is the expected end of a line."""
    came = f"only {unread[:40]!r} came"
    if (found := _ENDS.get(unread[-1:])) is not None and not unread.endswith(end):
        return Cause(
            f"{came}. It ends in {found}, which is not the expected end of a line",
            "Set the device to another end of its lines; of a described device, correct reply_end.",
        )
    return Cause(
        came,
        "It answers: check that the station file names the right driver, baud rate and frame for this port.",
    )
