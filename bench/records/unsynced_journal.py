"""A journal that is not synced line by line: for rehearsals, which may be lost with the power and are done again."""

from __future__ import annotations

from bench.records.journal import Journal


class UnsyncedJournal(Journal):
    """A journal as any other, but that the system chooses when its lines reach the disk."""

    def _sync(self) -> None:
        """Leave it to the system."""
