"""The events of a batch's journal, and the type of what each carries. Types only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any, NotRequired, TypedDict


class BatchEvent(StrEnum):
    """Kinds of lines in a batch's journal."""

    BEGUN = "batch_begun"
    """First line: name of the queue."""
    ITEM_BEGUN = "item_begun"
    """A run begins or is resumed (``again``); ``attempt`` is the number of the attempt, from 1."""
    ITEM_ENDED = "item_ended"
    """The attempt ended (a ``WorkerEnd``)."""
    REQUESTED = "requested"
    """An operator's request (`bench.batch.batch_requests`) and the answer: accepted, or refused with a reason."""
    ENDED = "batch_ended"
    """The batch ended: how and why. If it is called again, it continues."""


class BatchBegun(TypedDict):
    """Payload of ``batch_begun``; ``files`` gives the full path of each file that the queue names by a shorter name."""

    queue: str
    files: Mapping[str, str]
    rehearsal: NotRequired[bool]


class ItemBegun(TypedDict):
    """Payload of ``item_begun``: the run, whether it is resumed, the attempt, and the poses recorded before it."""

    item: str
    again: bool
    attempt: int
    recorded: int


class ItemEnded(TypedDict):
    """Payload of ``item_ended``: the run, and its `bench.batch.supervisor.WorkerEnd`."""

    item: str
    how: str
    why: str
    noticed_s: float
    unsafe: Sequence[str]
    outside: NotRequired[bool]
    devices: NotRequired[Sequence[Mapping[str, str]]]


class Requested(TypedDict):
    """Payload of ``requested``: the request, who made it, whether it was accepted, and why not."""

    id: str
    word: str
    taken: bool
    why: str
    by: NotRequired[str]
    known_by: NotRequired[str]
    name: NotRequired[str]
    job: NotRequired[Mapping[str, Any]]


class BatchEnded(TypedDict):
    """Payload of ``batch_ended``."""

    how: str
    why: str
