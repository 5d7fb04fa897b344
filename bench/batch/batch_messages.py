"""Tells of a batch what none of its workers can: that one died, hung or could not begin, and how the batch ended.

To whom, each run's station file says. A worker that failed by itself has told of it already: the same key then, and
nothing is told twice. Knows no devices.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

from bench.base.clock import BenchClock
from bench.base.errors import BenchError
from bench.base.home import home_folder
from bench.batch.supervisor import WorkerEnd
from bench.messaging.messages import Courier
from bench.messaging.outbox import Outbox
from bench.records.journal import read_journal
from bench.records.run_folder import JOURNAL
from bench.run.status import read_status, status_text
from bench.stations.station import load_station
from bench.stations.station_messages import MessagesConfig
from sequences.errors import DocumentFaults

REPORTED_BY_BATCH = frozenset({"died", "hung", "failed"})


class BatchMessages:
    """Messages of one batch.

    Parameters
    ----------
    clock
        Tells the time.
    say
        Told what could not be kept; a batch is not ended for that.
    """

    def __init__(self, clock: BenchClock, say: Callable[[str], None]) -> None:
        self._clock = clock
        self._say = say
        self._couriers: dict[str, Courier] = {}

    def run_ended(self, key: str, station: str, run: Path, end: WorkerEnd, line: str) -> None:
        """Tell of a run that ended otherwise than it should.

        Parameters
        ----------
        key
            Name of the run in the batch.
        station
            Its station file.
        run
            Its folder.
        end
            How it ended.
        line
            Hash of the batch's line that tells of it.
        """
        courier = self._courier(station)
        if courier is None or end.how not in REPORTED_BY_BATCH:
            return
        what = f"{end.how}{': ' if end.why else ''}{end.why}"
        text = _status_of(run)
        if end.how != "failed":
            made_safe = end.unsafe or ["The stage it had is stopped, its light is off."]
            text = "\n".join([f"Its process {what}", *made_safe, "", text])
        subject = f"Starbench: run {key} {what}"
        said_by_itself = _journal_head(run) if end.how == "failed" else ""
        courier.write("failure", subject, text, run=key, folder=run, key=said_by_itself or line)

    def batch_ended(
        self, name: str, how: str, why: str, runs: Iterable[str], folder: Path, line: str
    ) -> None:
        """Tell everybody who hears of any of its runs how the batch ended."""
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
            )

    def add_recipients(self, stations: Iterable[str]) -> None:
        """Get to know who hears of the runs on these stations."""
        for station in stations:
            self._courier(station)

    def close(self) -> None:
        """Try once more what is waiting."""
        for courier in self._couriers.values():
            courier.close()

    def _courier(self, station: str) -> Courier | None:
        try:
            messages = load_station(station).value.messages
        except DocumentFaults as error:
            self._say(f"{station} cannot be read any more, nobody can be told: {error}")
            return None
        name = json.dumps(messages.model_dump(), sort_keys=True)
        if name not in self._couriers:
            self._couriers[name] = self._make(messages)
        return self._couriers[name]

    def _make(self, messages: MessagesConfig) -> Courier:
        return Courier(messages, Outbox(home_folder()), self._clock, self._say)


def _status_of(run: Path) -> str:
    try:
        return status_text(read_status(run))
    except BenchError as error:
        return str(error)


def _journal_head(run: Path) -> str:
    """Hash of the last line of a run's journal; empty where there is none."""
    try:
        entries, _ = read_journal(run / JOURNAL)
    except BenchError:
        return ""
    return entries[-1].hash if entries else ""
