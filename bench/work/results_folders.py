"""The folder of a recalculation of many runs: a folder of results for each, and one table of all.

A row of the table is a line of JSON. It is written before its folder gets its name; after a power cut the row without
folder counts as not done. Rows are added while the work goes on; at the end the table is written again, one row for
each run, in the order of the runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bench.base.errors import UsageError
from bench.evidence.keys import BenchKey
from bench.evidence.seal import seal_folder
from bench.record.run_folder import RESULTS
from bench.record.storage import new_output, sha256_of, storage_errors, write_atomic, write_files
from bench.work.kept_rows import Table, line_of
from bench.work.tasks import DoneRow, RunRow
from drivers.new_output import TEMPORARY, remove_unfinished

TABLE = "recalculated.jsonl"
_KEY_SHOWN = 8  # Hexadecimal digits that tell folders of one name apart


class ResultsFolders(Table):
    """The folder of a recalculation, used by one process at a time; what an interrupted one did is used again.

    ``key`` is the bench's; None leaves the results drafts. ``table_only`` writes no folder for a run.
    """

    foreign = "The folder is not that of a recalculation"

    def __init__(self, folder: Path, key: BenchKey | None, *, table_only: bool = False) -> None:
        with storage_errors(folder):
            is_file = folder.exists() and not folder.is_dir()
        if is_file:
            raise UsageError("This is a file, not a folder.", where=str(folder), remedy="Choose another -o.")
        self.folder, self.key, self.table_only = folder, key, table_only
        self._reserved: set[str] = set()
        super().__init__(folder, TABLE)
        try:
            for left in folder.glob(f".*{TEMPORARY}"):  # of a process that was killed
                remove_unfinished(left)
        except BaseException:
            self.__exit__()
            raise

    def done(self, place: str, key: str) -> DoneRow | None:
        """Return the row of a calibration of this key; None if it is to be done, or its results have changed."""
        row: RunRow | None = self._rows.get(place)
        if row is None or row["state"] != "done" or row["key"] != key:
            return None
        if self.table_only:
            return row
        if row["results"] is None:
            return None
        results = self.folder / row["results"] / RESULTS
        try:
            whole = results.is_file() and sha256_of(results) == row["results_sha256"]
        except OSError:
            return None
        return row if whole else None

    def name_for(self, place_name: str, key: str) -> str:
        """Return a free name: that of the calibrated folder, and first digits of the key. It is not given out again."""
        name = f"{place_name}-{key[:_KEY_SHOWN]}"
        number = 1
        while name in self._reserved or (self.folder / name).exists():
            number += 1
            name = f"{place_name}-{key[:_KEY_SHOWN]}-{number}"
        self._reserved.add(name)
        return name

    def write(self, name: str, files: Mapping[str, bytes], row: DoneRow) -> None:
        """Write, seal and name a folder of results, and add its row."""
        with new_output(self.folder / name) as part:
            write_files(part, files)
            if self.key is not None:
                seal_folder(part, self.key)
            self.append(row)

    def finish(self, rows: Iterable[RunRow]) -> None:
        """Write the table again, in the order given; rows of folders that were not given this time stay behind them."""
        given = {row["folder"]: row for row in rows}
        others = [row for place, row in self._rows.items() if place not in given]
        write_atomic(self.path, b"".join(line_of(row) for row in (*given.values(), *others)))

    def _known(self, row: Any) -> tuple[str, Any]:
        if not {"state", "key", "results", "results_sha256"} <= row.keys():
            raise KeyError(row)
        return str(row["folder"]), row
