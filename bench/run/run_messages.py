"""Messages about one run: when it fails, holds or ends, its status goes to the outbox as text.

How a message travels is `bench.messaging`'s work; what a status says is `bench.run.status`'s.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bench.base.errors import BenchError
from bench.messaging.messages import Courier
from bench.run.status import read_status, status_text


class RunMessages:
    """Writes messages about one run.

    Parameters
    ----------
    courier
        Takes messages to the outbox and delivers them.
    folder
        The run folder.
    say
        Shows the operator why a message could not be written; the run goes on.
    """

    def __init__(self, courier: Courier, folder: Path, say: Callable[[str], None]) -> None:
        self._courier = courier
        self._folder = folder
        self._say = say

    def write(self, occasion: str, what: str, key: str) -> None:
        """Write a message with the run's status, if the station file asks for it. Returns at once.

        Parameters
        ----------
        occasion
            ``failure``, ``hold`` or ``end``.
        what
            A few words for the subject.
        key
            Identifies this message for ever: the hash of the journal's line that gave occasion to it.
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
            occasion, subject, status_text(status), run=status.run_id, folder=self._folder, key=key
        )
