"""An inbox of a process: a folder in which other processes leave messages, one JSON file each, written as a whole.

The owner answers each in its journal, then removes the file: one that was answered by a process that died is known by
its id.
"""

from __future__ import annotations

import stat
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Generic, Literal, TypeVar

from pydantic import BaseModel, Field, ValidationError

from bench.record.storage import is_temporary, remove, storage_errors, write_atomic

MessageId = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
"""Unique id of a message; it is a part of the name of its file."""
KnownBy = Literal["token", "file mode", "typed"]
"""How the name of a sender is known: the page's token was shown, the system named the user who may write into the
folder, or somebody typed it."""
Message = TypeVar("Message", bound=BaseModel)


@dataclass(frozen=True)
class Inbox(Generic[Message]):
    """The folder, and what may lie in it."""

    folder: Path  # Where senders leave their files
    model: type[Message]  # Model of a message
    max_bytes: int  # Size of the largest file that is read; anything larger is not a message
    ignored: frozenset[str] = frozenset()  # Names of files in the folder that are not for the owner

    def drop(self, message: Message, message_id: str) -> Path:
        """Leave a message behind all earlier ones, as a whole; `StorageError` if the owner has removed the inbox."""
        path = self.folder / f"{time.time_ns():020d}-{message_id}.json"
        write_atomic(path, message.model_dump_json().encode() + b"\n")
        return path

    def drain(self, answer: Callable[[Message | None, str], None]) -> None:
        """Answer every message, oldest first, and remove its file once ``answer`` has stored it; None is a bad file."""
        with storage_errors(self.folder):
            if not self.folder.is_dir():
                return
            commands = [
                p for p in self.folder.iterdir() if not is_temporary(p) and p.name not in self.ignored
            ]
        for path in sorted(commands):
            with storage_errors(path), suppress(FileNotFoundError):  # its sender takes it back at this moment
                answer(self._read(path), path.name)
                remove(path)

    def _read(self, path: Path) -> Message | None:
        """Read a message; None for anything else. A pipe is not opened: that would wait for a writer."""
        status = path.lstat()
        if not stat.S_ISREG(status.st_mode) or status.st_size > self.max_bytes:
            return None
        try:
            return self.model.model_validate_json(path.read_bytes())
        except ValidationError:
            return None


class Poller:
    """Calls a function at intervals, in a thread of its own, which ends with ``failed`` and the exception it raised."""

    def __init__(
        self, look: Callable[[], None], failed: Callable[[Exception], None], *, name: str, period_s: float
    ) -> None:
        self._look = look
        self._failed = failed
        self._period_s = period_s
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @property
    def closed(self) -> bool:
        """Whether ``close`` has been called."""
        return self._closing.is_set()

    def start(self) -> None:
        """Begin to call."""
        self._thread.start()

    def close(self) -> None:
        """Call no more; returns after a call that is under way has ended."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        try:
            while not self._closing.wait(self._period_s):
                self._look()
        except Exception as error:  # noqa: BLE001 - passed on to who decides
            self._failed(error)
