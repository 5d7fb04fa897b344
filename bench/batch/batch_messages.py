"""Messages of a batch that no run can send: a process died, hung or could not begin; the batch ended.

The station file of each run names the recipients. If a run has sent a message about its failure itself, the batch uses
the same key, so that nobody receives the message twice.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from bench.base.clock import BenchClock
from bench.base.errors import BenchError
from bench.base.home import home_folder
from bench.batch.supervisor import WorkerEnd
from bench.messaging.messages import Courier
from bench.messaging.outbox import Outbox
from bench.records.journal import read_journal
from bench.records.run_folder import JOURNAL
from bench.run.status import read_status
from bench.run.status_text import status_text
from bench.stations.station import load_station
from bench.stations.station_messages import MessagesConfig
from sequences.errors import DocumentFaults

REPORTED_BY_BATCH = frozenset({"died", "hung", "failed"})


class BatchMessages:
    """Messages of one batch.

    say: Receives reports about messages that could not be stored or sent; these do not end the batch.
    """

    def __init__(self, clock: BenchClock, say: Callable[[str], None]) -> None:
        self._clock = clock
        self._say = say
        self._couriers: dict[str, Courier] = {}

    def run_ended(self, key: str, station: str, run: Path, end: WorkerEnd, line: str) -> None:
        """Send a message about a run that failed, died or hung.

        end: How the run's process ended.
        line: Hash of the line in the batch's journal that records this end.
        """
        courier = self._courier(station)
        if courier is None or end.how not in REPORTED_BY_BATCH:
            return
        what = f"{end.how}{': ' if end.why else ''}{end.why}"
        text, place = _status_of(run, asked=bool(end.devices))
        if end.how != "failed":
            answers = [one.text for one in end.devices] or ["No device was asked after that."]
            text = "\n".join([f"Its process {what}", *answers, "", text])
        subject = f"Starbench: run {key} {what}"
        own_message = _journal_head(run) if end.how == "failed" else ""
        courier.write("failure", subject, text, run=key, folder=run, key=own_message or line, place=place)

    def batch_ended(
        self,
        name: str,
        how: str,
        why: str,
        runs: Iterable[str],
        folder: Path,
        line: str,
        *,
        place: tuple[int, str] | None = None,
    ) -> None:
        """Send a message about the end of the batch to all recipients of its runs.

        line: Hash of the line in the batch's journal that records the end.
        place: Number and line in the bench's ledger of the newest run of the batch; None if there is none.
        """
        what = f"{how}{': ' if why else ''}{why}"
        text = "\n".join([f"Batch {name}: {what}", "", *runs])
        for courier in self._couriers.values():
            courier.write(
                "end" if how in {"finished", "aborted"} else "failure",
                f"Starbench: batch {name} {what}",
                text,
                run=name,
                folder=folder,
                key=line,
                place=place,
            )

    def add_recipients(self, stations: Iterable[str]) -> None:
        """Add the recipients that these stations name."""
        for station in stations:
            self._courier(station)

    def close(self) -> None:
        """Try once more to send the messages that are waiting."""
        for courier in self._couriers.values():
            courier.close()

    def _courier(self, station: str) -> Courier | None:
        try:
            messages = load_station(station).value.messages
        except DocumentFaults as error:
            self._say(f"{station} cannot be read any more, so no message can be sent: {error}")
            return None
        name = json.dumps(messages.model_dump(), sort_keys=True)
        if name not in self._couriers:
            self._couriers[name] = self._make(messages)
        return self._couriers[name]

    def _make(self, messages: MessagesConfig) -> Courier:
        return Courier(messages, Outbox(home_folder()), self._clock, self._say)


def _status_of(run: Path, *, asked: bool) -> tuple[str, tuple[int, str] | None]:
    """Return the status of a run as text, without its devices if they were asked since, and its place in the ledger."""
    try:
        status = read_status(run)
    except BenchError as error:
        return str(error), None
    return status_text(replace(status, devices=()) if asked else status), status.place


def _journal_head(run: Path) -> str:
    """Return the hash of the last line of a run's journal; empty if there is none."""
    try:
        entries, _ = read_journal(run / JOURNAL)
    except BenchError:
        return ""
    return entries[-1].hash if entries else ""
