"""Messages about one run: when it fails, holds or ends, its status goes to the outbox as text.

`bench.messaging` delivers the messages; `bench.run.status` makes the text.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bench.base.errors import BenchError
from bench.messaging.messages import Courier
from bench.run.status import read_status
from bench.run.status_text import status_text


class RunMessages:
    """Writes messages about one run.

    say: Prints for the operator why a message could not be written; the run continues.
    """

    def __init__(self, courier: Courier, folder: Path, say: Callable[[str], None]) -> None:
        self._courier = courier
        self._folder = folder
        self._say = say

    def write(self, occasion: str, what: str, key: str) -> None:
        """Write a message with the run's status, if the station file asks for it. Returns at once.

        occasion: ``failure``, ``hold`` or ``end``.
        key: Unique name of this message: the hash of the journal's line that caused it.
        """
        if not self._courier.is_wanted(occasion):
            return
        try:
            status = read_status(self._folder)
        except BenchError as error:
            self._say(f"A message could not be written: {error}")
            return
        simulated = " (SIMULATED)" if status.simulated else ""
        subject = f"Starbench: run {status.run_id}{simulated} {what}"
        self._courier.write(
            occasion,
            subject,
            status_text(status),
            run=status.run_id,
            folder=self._folder,
            key=key,
            place=status.place,
        )
