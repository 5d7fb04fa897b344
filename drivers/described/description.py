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
    """A request and its reply."""

    send: Template
    reply: Template | None = None  # The form of the reply; None when the device does not answer


@dataclass(frozen=True)
class Refusal:
    """A reply by which the device refuses a request."""

    reply: Template  # Its form; a value ``message`` or ``code`` in it is told
    means: str = ""  # What it means; empty when the message says it
    codes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Notice:
    """A text that the device sends without a request, within a line or alone."""

    text: str
    means: str = ""  # What it means for a move; empty when it means nothing


@dataclass(frozen=True, kw_only=True)
class LineDescription:
    """The line to a device."""

    maker: str
    model: str
    baudrate: int  # Bits per second, where the station file gives none
    request_end: bytes
    reply_end: bytes
    reply_s: float  # Longest wait for a reply, in seconds
    quiet_s: float  # After this time without a byte, the line counts as silent; in seconds
    # Longest time from the opening of the port to the first answer, in seconds: some boards restart then.
    start_s: float
    # "xor": requests and replies end in ``*`` and two hexadecimal digits, the XOR of all bytes before the
    # ``*``.
    checksum: Checksum
    # Sent before the end of a request, when a beginning of a request may be in the device's buffer: it makes
    # that request invalid. Without it, a query that was cut could become a command.
    clear: bytes
    # Requests that set the form of the replies, and nothing else. Sent at opening and when the line is out of
    # step.
    setup: tuple[Template, ...]
    identity: Exchange  # Query whose answer never changes. Value ``firmware`` is told if the reply has it.
    serial: Exchange | None  # Query of the serial number, value ``serial``; None if the device has none
    refusals: tuple[Refusal, ...]
    notices: tuple[Notice, ...]


@dataclass(frozen=True)
class Switch:
    """A query of a state that has two sides, such as moving or idle."""

    query: Exchange  # The query; its reply has the value ``state``
    # Answers that mean the second side (idle, homed, on, no fault); numbers are compared as numbers.
    true_words: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class AxisSetting:
    """A setting of an axis that is written at opening where it differs, and read back."""

    quantity: AxisQuantity
    # set, query: How to write it, and how to read it; both carry ``value``.
    set: Exchange
    query: Exchange
    constant: float = 0.0  # Value of a setting that does not depend on the station file
    # Largest difference between the value that was written and the one that is read, in percent.
    tolerance_percent: float = 0.0


@dataclass(frozen=True, kw_only=True)
class StageDescription:
    """A stage whose controller has a described protocol. Positions are in the controller's counts."""

    line: LineDescription
    move: Exchange  # Starts a move to the absolute position ``target``
    stop: Exchange
    position: Exchange  # Query of the position counter, value ``counts``
    idle: Switch  # Query whether an axis is idle
    home: Exchange  # Starts the search of an axis's reference
    home_replies_at_end: bool  # Whether the reply to ``home`` comes only when the search has ended
    # Query of the encoder in the units of the counter, value ``counts``; None if there is none.
    encoder: Exchange | None
    # Query whether an axis has a reference; None if the controller does not tell: only a homing by the driver
    # counts.
    reference: Switch | None
    faults: Switch | None  # Query of faults of an axis; None if there is none
    scale: Exchange | None  # Query of the controller's scale, value ``scale``; None if it does not tell
    scale_unit: ScaleUnit
    # lowest, highest: Queries of the controller's own ends of the travel, value ``counts``; None if it does
    # not tell.
    lowest: Exchange | None
    highest: Exchange | None
    settings: tuple[AxisSetting, ...]
    setup: tuple[Exchange, ...]  # Commands to each axis at opening, after the settings; they move nothing


@dataclass(frozen=True, kw_only=True)
class LightSetting:
    """A setting of a light."""

    quantity: LightQuantity
    # set, query: How to write it, and how to read it; both carry ``value``.
    set: Exchange
    query: Exchange
    # The device's value is this factor times the quantity, or times 1 / quantity if ``inverse``.
    factor: float = 1.0
    inverse: bool = False  # Whether the device takes the reciprocal, as a period instead of a frequency
    # The device's words by Starbench's (``square``, ``steady``, ``on``, ``off``); empty for a number.
    words: Mapping[str, str] = field(default_factory=dict)
    constant: float = 0.0  # Value of a setting that does not depend on the sequence
    lowest: float = float("-inf")
    highest: float = float("inf")
    # Largest difference between the value that was written and the one that is read, in percent.
    tolerance_percent: float = 0.0


@dataclass(frozen=True, kw_only=True)
class LightDescription:
    """A light whose controller has a described protocol."""

    line: LineDescription
    on: Exchange
    off: Exchange
    is_on: Switch
    faults: Switch | None  # Query of faults; None if there is none
    settings: tuple[LightSetting, ...]  # The settings, in the order in which they are written
