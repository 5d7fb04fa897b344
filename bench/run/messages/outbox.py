"""The outbox of a bench: a folder with one file for each message to each channel; the name's suffix is the state.

``ID.waiting`` becomes ``ID.sending-MICROSECONDS`` while a process tries to deliver it, then ``ID.sent``, or again
``ID.waiting``, or ``ID.failed`` after ``MOST_TRIES``. A process claims a file by renaming it, so no other one has it.
The claim ends at the time in the name: what a killed process was sending is tried again, and may arrive twice.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter

from bench.base.errors import StorageError
from bench.record.storage import is_temporary, make_folder, read_bounded, storage_errors, write_atomic
from bench.stations.messages_section import Channel
from drivers.durable import sync_folder

OUTBOX = "outbox"
CLAIM = timedelta(minutes=3)
"""A claim ends after this time: a mail of ten steps, each within `channels.TIMEOUT_S`, takes 100 s at most."""
FIRST_PAUSE_S = 5.0  # Doubled after each try
LONGEST_PAUSE_S = 3600.0
MOST_TRIES = 100
"""A delivery is given up after so many tries: a server may be away for four days in which runs are done."""
_MOST_BYTES = 1_000_000
_WAITING, _SENDING, _SENT, _FAILED = ".waiting", ".sending-", ".sent", ".failed"

State = Literal["waiting", "sending", "sent", "failed"]


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
    # Number of the run in the bench's ledger; of a batch, that of the newest run. None before the run is entered.
    ledger_number: int | None = None
    ledger_head: str | None = None  # Hash of that line of the ledger


@dataclass(frozen=True)
class Delivery:
    """The delivery of one message to one channel."""

    message: Message
    channel: Channel
    tries: int = 0
    next_try_utc: str = ""  # ISO 8601; empty: at once
    perhaps_twice: bool = False  # Whether it may have arrived more than once
    last_error: str = ""  # Why the last try failed; empty if it did not


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
                write_atomic(self.folder / f"{name}{_WAITING}", _written(Delivery(message, channel)))

    def deliveries(self) -> list[tuple[State, Delivery]]:
        """List all deliveries, also those that were sent, oldest first."""
        while True:
            files = self._files()
            kept = [(state, each) for path, state in files.items() if (each := _read(path)) is not None]
            if len(kept) == len(files):  # else another process has renamed one
                return sorted(kept, key=lambda each: (each[1].message.utc, each[1].message.key))

    def waiting(self) -> int:
        """Count the deliveries that still wait, or that a process is trying."""
        return sum(state in {"waiting", "sending"} for state in self._files().values())

    def deliver(
        self, send: Send, utc_now: Callable[[], datetime], *, all_kept: bool = False
    ) -> list[Delivery]:
        """Try the deliveries that are due, one after another; return those that are given up.

        After a failure the other messages to the same channel wait, so that a server that hangs delays no other
        channel for long. With ``all_kept`` everything that was not sent is tried.
        """
        given_up: list[Delivery] = []
        down: set[Channel] = set()
        for path, delivery in self._due(utc_now(), all_kept=all_kept):
            if delivery.channel in down and not all_kept:
                continue
            tried = self._try(path, delivery, send, utc_now())
            if tried is not None and tried.last_error:
                down.add(tried.channel)
                given_up += [tried] if tried.tries >= MOST_TRIES else []
        return given_up

    def _due(self, now: datetime, *, all_kept: bool) -> list[tuple[Path, Delivery]]:
        """Return what may be tried now: the fewest tries first, so that nothing stands behind what always fails."""
        due = []
        for path, state in self._files().items():
            if state == "sent" or (state == "failed" and not all_kept) or not _is_free(path, now):
                continue
            with suppress(StorageError):  # a damaged file holds up no other; `deliveries` names it
                delivery = _read(path)
                if delivery is not None and (all_kept or _has_come(delivery, now)):
                    due.append((path, delivery))
        return sorted(due, key=lambda each: (each[1].tries, each[1].message.utc, each[1].message.key))

    def _try(self, path: Path, delivery: Delivery, send: Send, now: datetime) -> Delivery | None:
        """Claim a file and try its delivery; return the delivery after that, None if another process was quicker."""
        claimed = path.with_name(f"{path.stem}{_SENDING}{_microseconds(now + CLAIM)}")
        with storage_errors(path):
            try:
                path.rename(claimed)
            except FileNotFoundError:
                return None
        tries = delivery.tries + 1
        # A claim that has ended is that of a process which was killed while it was sending.
        perhaps_twice = delivery.perhaps_twice or path.suffix.startswith(_SENDING)
        pause_s = min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** min(delivery.tries, 20))
        try:
            send(delivery.message, delivery.channel)
        except DeliveryFailed as error:
            later = (now + timedelta(seconds=pause_s)).isoformat()
            suffix, why = (_WAITING if tries < MOST_TRIES else _FAILED), str(error)[:500]
        else:
            suffix, later, why = _SENT, "", ""
        tried = replace(
            delivery, tries=tries, next_try_utc=later, perhaps_twice=perhaps_twice, last_error=why
        )
        with storage_errors(claimed):
            if claimed.exists():  # else another process took it over, because the claim had ended
                write_atomic(claimed, _written(tried))
                claimed.rename(claimed.with_suffix(suffix))
                sync_folder(self.folder)
        return tried

    def _files(self) -> dict[Path, State]:
        """Return the files of the outbox, each with its state; none before the first message."""
        with storage_errors(self.folder):
            if not self.folder.exists():
                return {}
            files = [path for path in self.folder.iterdir() if not is_temporary(path)]
        return {path: state for path in files if (state := _state(path)) is not None}


def _state(path: Path) -> State | None:
    """Return the state of a delivery by the name of its file; None for a file of somebody else."""
    states: dict[str, State] = {_WAITING: "waiting", _SENT: "sent", _FAILED: "failed"}
    return "sending" if path.suffix.startswith(_SENDING) else states.get(path.suffix)


def _is_free(path: Path, now: datetime) -> bool:
    """Whether no living claim is on a file; one beyond ``CLAIM`` was made before the system's time was set back."""
    if not path.suffix.startswith(_SENDING):
        return True
    ends = path.suffix.removeprefix(_SENDING)
    return not (ends.isdigit() and _microseconds(now) < int(ends) <= _microseconds(now + CLAIM))


def _has_come(delivery: Delivery, now: datetime) -> bool:
    """Whether it is time to try; a time beyond the longest pause was noted before the system's time was set back."""
    if not delivery.next_try_utc:
        return True
    left_s = (datetime.fromisoformat(delivery.next_try_utc) - now).total_seconds()
    return not 0 < left_s <= LONGEST_PAUSE_S


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
