"""A journal that is not synced line by line, for rehearsals: one that is lost can be repeated."""

from __future__ import annotations

from bench.record.journal import Journal


class UnsyncedJournal(Journal):
    """A journal whose lines are written to the disk when the operating system chooses."""

    def _sync(self) -> None:
        """Do nothing."""
