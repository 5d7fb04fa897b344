"""What is new in the list of runs and batches since a page was last told: a page gets the rows that changed."""

from __future__ import annotations

from typing import Literal

from bench.extras.pages.panel.shown_run import FolderContent, ListedBatch, ListedRun, ListHead, ListMessage

_Place = tuple[Literal["runs", "batches"], str]


class ListChanges:
    """Versions of a list, counted from 1, for all its pages; each row has the version at which it changed last."""

    def __init__(self) -> None:
        self.version = 0
        self._content: FolderContent = {
            "root": "", "exists": False, "unread": 0, "runs": [], "batches": [], "faults": [],
        }  # fmt: skip
        self._rows: dict[_Place, tuple[int, ListedRun | ListedBatch]] = {}
        self._gone: dict[_Place, int] = {}

    def take(self, content: FolderContent) -> None:
        """Take the list as it is now; it is a new version if anything has changed."""
        version = self.version + 1
        rows: dict[_Place, ListedRun | ListedBatch] = {
            **{("runs", row["key"]): row for row in content["runs"]},
            **{("batches", row["key"]): row for row in content["batches"]},
        }
        changed = {p: row for p, row in rows.items() if p not in self._rows or self._rows[p][1] != row}
        gone = self._rows.keys() - rows.keys()
        if not changed and not gone and _head(content) == _head(self._content):
            return
        for place in gone:
            del self._rows[place]
            self._gone[place] = version
        for place, row in changed.items():
            self._rows[place] = version, row
            self._gone.pop(place, None)
        self.version, self._content = version, content

    def since(self, version: int) -> ListMessage:
        """Return what changed after a version; everything after version 0, which no page has."""
        content = self._content
        gone = [place for place, changed in self._gone.items() if changed > version and version]
        return {
            **_head(content),
            "since": version,
            "version": self.version,
            "reset": version == 0,
            "runs": [row for row in content["runs"] if self._rows["runs", row["key"]][0] > version],
            "batches": [row for row in content["batches"] if self._rows["batches", row["key"]][0] > version],
            "gone": [key for _, key in gone],
        }


def _head(content: FolderContent) -> ListHead:
    return {
        "root": content["root"],
        "exists": content["exists"],
        "unread": content["unread"],
        "faults": content["faults"],
    }
