"""What a description says of a device: requests, replies, units. Plain data; the bench reads the files.

Names of values that a stage's requests may carry: ``target`` (controller's counts), of settings ``value``. A light's
requests carry ``value``. ``{address}`` is the axis's address, ``{request}`` in a reply is the request that was sent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from drivers.described.template import Template

Checksum = Literal["none", "xor"]
AxisQuantity = Literal["speed", "acceleration", "lowest", "highest", "constant"]
ScaleUnit = Literal["counts_per_deg", "deg_per_count", "arcsec_per_count"]
LightQuantity = Literal["waveform", "frequency_hz", "duty_percent", "level_percent", "sync", "constant"]


@dataclass(frozen=True)
class Exchange:
    """A request and its reply.

    Attributes
    ----------
    send
        The request.
    reply
        The form of the reply; None when the device does not answer.
    """

    send: Template
    reply: Template | None = None


@dataclass(frozen=True)
class Refusal:
    """A reply by which the device refuses a request.

    Attributes
    ----------
    reply
        Its form; a value ``message`` or ``code`` in it is told.
    means
        What it means; empty when the message says it.
    codes
        Meanings by code.
    """

    reply: Template
    means: str = ""
    codes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Notice:
    """A text that the device sends without a request, within a line or alone.

    Attributes
    ----------
    text
        The text.
    means
        What it means for a move; empty when it means nothing.
    """

    text: str
    means: str = ""


@dataclass(frozen=True, kw_only=True)
class LineDescription:
    """The line to a device.

    Attributes
    ----------
    maker, model
        What the device is.
    baudrate
        Bits per second, where the station file gives none.
    request_end, reply_end
        Bytes at the end of each request and of each reply.
    reply_s
        Longest wait for a reply, in seconds.
    quiet_s
        After this time without a byte, the line counts as silent; in seconds.
    start_s
        Longest time from the opening of the port to the first answer, in seconds: some boards restart then.
    checksum
        "xor": requests and replies end in ``*`` and two hexadecimal digits, the XOR of all bytes before the ``*``.
    clear
        Sent before the end of a request, when a beginning of a request may be in the device's buffer: it makes that
        request invalid. Without it, a query that was cut could become a command.
    setup
        Requests that set the form of the replies, and nothing else. Sent at opening and when the line is out of step.
    identity
        Query whose answer never changes. Value ``firmware`` is told if the reply has it.
    serial
        Query of the serial number, value ``serial``; None if the device has none.
    refusals, notices
        See their classes.
    """

    maker: str
    model: str
    baudrate: int
    request_end: bytes
    reply_end: bytes
    reply_s: float
    quiet_s: float
    start_s: float
    checksum: Checksum
    clear: bytes
    setup: tuple[Template, ...]
    identity: Exchange
    serial: Exchange | None
    refusals: tuple[Refusal, ...]
    notices: tuple[Notice, ...]


@dataclass(frozen=True)
class Switch:
    """A query of a state that has two sides, such as moving or idle.

    Attributes
    ----------
    query
        The query; its reply has the value ``state``.
    true_words
        Answers that mean the second side (idle, homed, on, no fault); numbers are compared as numbers.
    """

    query: Exchange
    true_words: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class AxisSetting:
    """A setting of an axis that is written at opening where it differs, and read back.

    Attributes
    ----------
    quantity
        What it is.
    set, query
        How to write it, and how to read it; both carry ``value``.
    constant
        Value of a setting that does not depend on the station file.
    tolerance_percent
        Largest difference between the value that was written and the one that is read, in percent.
    """

    quantity: AxisQuantity
    set: Exchange
    query: Exchange
    constant: float = 0.0
    tolerance_percent: float = 0.0


@dataclass(frozen=True, kw_only=True)
class StageDescription:
    """A stage whose controller has a described protocol. Positions are in the controller's counts.

    Attributes
    ----------
    line
        The line.
    move
        Starts a move to the absolute position ``target``.
    stop
        Stops all axes.
    position
        Query of the position counter, value ``counts``.
    idle
        Query whether an axis is idle.
    home
        Starts the search of an axis's reference.
    home_replies_at_end
        Whether the reply to ``home`` comes only when the search has ended.
    encoder
        Query of the encoder in the units of the counter, value ``counts``; None if there is none.
    reference
        Query whether an axis has a reference; None if the controller does not tell: only a homing by the driver counts.
    faults
        Query of faults of an axis; None if there is none.
    scale
        Query of the controller's scale, value ``scale``; None if it does not tell.
    scale_unit
        Unit of that value.
    lowest, highest
        Queries of the controller's own ends of the travel, value ``counts``; None if it does not tell.
    settings
        Settings of each axis.
    setup
        Commands to each axis at opening, after the settings; they move nothing.
    """

    line: LineDescription
    move: Exchange
    stop: Exchange
    position: Exchange
    idle: Switch
    home: Exchange
    home_replies_at_end: bool
    encoder: Exchange | None
    reference: Switch | None
    faults: Switch | None
    scale: Exchange | None
    scale_unit: ScaleUnit
    lowest: Exchange | None
    highest: Exchange | None
    settings: tuple[AxisSetting, ...]
    setup: tuple[Exchange, ...]


@dataclass(frozen=True, kw_only=True)
class LightSetting:
    """A setting of a light.

    Attributes
    ----------
    quantity
        What it is.
    set, query
        How to write it, and how to read it; both carry ``value``.
    factor
        The device's value is this factor times the quantity, or times 1 / quantity if ``inverse``.
    inverse
        Whether the device takes the reciprocal, as a period instead of a frequency.
    words
        The device's words by Starbench's (``square``, ``steady``, ``on``, ``off``); empty for a number.
    constant
        Value of a setting that does not depend on the sequence.
    lowest, highest
        Range of the quantity.
    tolerance_percent
        Largest difference between the value that was written and the one that is read, in percent.
    """

    quantity: LightQuantity
    set: Exchange
    query: Exchange
    factor: float = 1.0
    inverse: bool = False
    words: Mapping[str, str] = field(default_factory=dict)
    constant: float = 0.0
    lowest: float = float("-inf")
    highest: float = float("inf")
    tolerance_percent: float = 0.0


@dataclass(frozen=True, kw_only=True)
class LightDescription:
    """A light whose controller has a described protocol.

    Attributes
    ----------
    line
        The line.
    on, off
        Switch the output.
    is_on
        Query of the output.
    faults
        Query of faults; None if there is none.
    settings
        The settings, in the order in which they are written.
    """

    line: LineDescription
    on: Exchange
    off: Exchange
    is_on: Switch
    faults: Switch | None
    settings: tuple[LightSetting, ...]
