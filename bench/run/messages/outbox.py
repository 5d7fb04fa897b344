"""The outbox of a bench: a folder with one file for each message to each channel; the name's suffix is the state.

``ID.waiting`` becomes ``ID.sending-MICROSECONDS`` while a process tries to deliver it, then ``ID.sent``, or again
``ID.waiting``, or after a week ``ID.failed``. A process claims a file by renaming it, so no other one has it. The name
has the time of the claim, which does not hold long: what a killed process was sending is tried again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter

from bench.base.errors import StorageError
from bench.record.storage import is_temporary, make_folder, read_bounded, storage_errors, write_atomic
from bench.stations.messages_section import Channel
from drivers.durable import sync_folder

OUTBOX = "outbox"
CLAIM = timedelta(minutes=3)
"""So long a claim holds: a mail of ten steps, each within `channels.TIMEOUT_S`, takes 100 s at most."""
GIVEN_UP_AFTER = timedelta(days=7)
"""A message of this age is given up when it fails again: a network may be away for a weekend."""
_SENDING = ".sending-"
_MOST_BYTES = 1_000_000  # A message has some kilobytes

State = Literal["waiting", "sending", "sent", "failed"]
_STATES: dict[str, State] = {".waiting": "waiting", ".sent": "sent", ".failed": "failed"}
"""States by the suffix of the file; ``sending`` has the time of its claim behind it."""


class DeliveryFailed(Exception):
    """A message could not be delivered; its text is the reason, without a secret."""


@dataclass(frozen=True)
class Message:
    """A message to people."""

    key: str  # Hash of the journal line that caused it
    occasion: str  # ``failure``, ``hold`` or ``end``
    subject: str
    text: str
    run: str  # The run or batch that it is about
    folder: str  # The folder of that
    utc: str  # Time at which it was written, ISO 8601


@dataclass(frozen=True)
class Delivery:
    """The delivery of one message to one channel."""

    message: Message
    channel: Channel
    tries: int = 0
    perhaps_twice: bool = False  # Whether it may have arrived more than once
    last_error: str = ""  # Why the last try failed; empty if it did not

    def to_dict(self) -> dict[str, Any]:
        """Return the delivery as JSON carries it."""
        data: dict[str, Any] = _form().dump_python(self, mode="json")
        return data


Send = Callable[[Message, Channel], None]
"""Delivers a message to a channel, or raises DeliveryFailed."""


class Outbox:
    """The outbox of a bench; other processes use it at the same time."""

    def __init__(self, home: Path) -> None:
        self.folder = home / OUTBOX

    def put(self, message: Message, channels: Sequence[Channel]) -> None:
        """Keep a message for its channels. It is on the disk when this returns; a key that is known changes nothing."""
        make_folder(self.folder)
        for channel in channels:
            name = hashlib.sha256(f"{message.key} {channel.model_dump_json()}".encode()).hexdigest()[:24]
            if not any(path.stem == name for path in self._files()):
                write_atomic(self.folder / f"{name}.waiting", _written(Delivery(message, channel)))

    def deliveries(self) -> list[tuple[State, Delivery]]:
        """List all deliveries, also those that were sent, oldest first."""
        while True:
            files = self._files()
            kept = [(state, each) for path, state in files.items() if (each := _read(path)) is not None]
            if len(kept) == len(files):  # else another process has renamed one
                return sorted(kept, key=lambda each: (each[1].message.utc, each[1].message.key))

    def unsent(self) -> int:
        """Count the deliveries that wait, that a process is trying, and that were given up."""
        return sum(state != "sent" for state in self._files().values())

    def deliver(
        self, send: Send, utc_now: Callable[[], datetime], *, by_hand: bool = False
    ) -> list[Delivery]:
        """Try what waits, one after another; return what failed. By hand, also try what was given up.

        After a failure the other messages to the same channel wait, so that a server that hangs does not delay another
        channel for long.
        """
        failed: list[Delivery] = []
        for path, delivery in self.due(utc_now(), by_hand=by_hand):
            if by_hand or delivery.channel not in [each.channel for each in failed]:
                tried = self._try(path, delivery, send, utc_now())
                failed += [tried] if tried.last_error else []
        return failed

    def due(self, now: datetime, *, by_hand: bool) -> list[tuple[Path, Delivery]]:
        """Return what may be tried now: the fewest tries first, so that nothing stands behind what always fails."""
        due = []
        for path, state in self._files().items():
            free = _is_left(path, now) if state == "sending" else state == "waiting" or by_hand
            if free and state != "sent":
                with suppress(StorageError):  # a damaged file holds up no other; `deliveries` names it
                    due += [(path, each)] if (each := _read(path)) is not None else []
        return sorted(due, key=lambda each: (each[1].tries, each[1].message.utc, each[1].message.key))

    def _try(self, path: Path, delivery: Delivery, send: Send, now: datetime) -> Delivery:
        """Claim a file and try its delivery, unless another process was quicker; return the delivery after that."""
        claimed = path.with_name(f"{path.stem}{_SENDING}{_microseconds(now)}")
        with storage_errors(path):
            try:
                path.rename(claimed)
            except FileNotFoundError:
                return replace(delivery, last_error="")
        suffix, why = ".sent", ""
        try:
            send(delivery.message, delivery.channel)
        except DeliveryFailed as error:
            age = now - datetime.fromisoformat(delivery.message.utc)
            suffix, why = (".waiting" if age < GIVEN_UP_AFTER else ".failed"), str(error)[:500]
        # Whoever left a claim behind was killed while it was sending.
        twice = delivery.perhaps_twice or path.suffix.startswith(_SENDING)
        tried = replace(delivery, tries=delivery.tries + 1, perhaps_twice=twice, last_error=why)
        with storage_errors(claimed):
            if claimed.exists():  # else another process took it over, because this one took too long
                write_atomic(claimed, _written(tried))
                claimed.rename(claimed.with_suffix(suffix))
                sync_folder(self.folder)
        return tried

    def _files(self) -> dict[Path, State]:
        """Return the files of the outbox, each with its state; none before the first message."""
        with storage_errors(self.folder):
            if not self.folder.exists():
                return {}
            paths = [path for path in self.folder.iterdir() if not is_temporary(path)]
        states = {
            path: "sending" if path.suffix.startswith(_SENDING) else _STATES.get(path.suffix)
            for path in paths
        }
        return {path: state for path, state in states.items() if state is not None}


def _is_left(path: Path, now: datetime) -> bool:
    """Whether a claim does not hold any more; one from the future was made before the system's time was set back."""
    claimed = path.suffix.removeprefix(_SENDING)
    return not claimed.isdigit() or abs(_microseconds(now) - int(claimed)) >= CLAIM / timedelta(
        microseconds=1
    )


def _microseconds(moment: datetime) -> int:
    return int(moment.timestamp() * 1e6)


@cache
def _form() -> TypeAdapter[Delivery]:
    return TypeAdapter(Delivery)


def _written(delivery: Delivery) -> bytes:
    return _form().dump_json(delivery, indent=1) + b"\n"


def _read(path: Path) -> Delivery | None:
    """Read a file; None if another process has renamed it meanwhile."""
    try:
        return _form().validate_json(read_bounded(path, _MOST_BYTES))
    except StorageError:
        if path.exists():
            raise
        return None
    except ValueError as error:
        raise StorageError(
            "This file of the outbox is damaged.",
            where=str(path),
            remedy="Restore it from a copy, or move it out of the folder.",
        ) from error
