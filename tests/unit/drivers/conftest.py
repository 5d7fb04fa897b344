"""Ends of a line for driver tests: a transcript that must be followed to the byte, and a clock that is turned."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from turned_clock import TurnedClock

from drivers.file_lock import FOLDER_VARIABLE
from drivers.link import Link


class ScriptedPort:
    """Answers what a transcript of (sent, received) pairs says, and nothing else."""

    name = "scripted"

    def __init__(self, pairs: list[tuple[bytes, bytes]]) -> None:
        self.pairs = list(pairs)
        self.ready = b""
        self.closed = False

    def write(self, data: bytes) -> None:
        assert self.pairs, f"{data!r} was sent after the end of the transcript"
        sent, received = self.pairs.pop(0)
        assert data == sent
        self.ready += received

    def read(self, timeout_s: float) -> bytes:
        data, self.ready = self.ready, b""
        return data

    def close(self) -> None:
        self.closed = True


class CountedLink(Link):
    """Counts how often it was to be brought back into step; keeps unsolicited lines, which begin with ``!``."""

    def __init__(self, port, clock, **more) -> None:
        super().__init__(port, clock=clock, **more)
        self.resynchronised = 0
        self.heard: list[bytes] = []

    def _resynchronise(self) -> None:
        self.resynchronised += 1

    def take_unsolicited(self, line: bytes) -> bool:
        self.heard += [line] if line.startswith(b"!") else []
        return line.startswith(b"!")


@pytest.fixture(autouse=True)
def locks(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of locks for this test alone: tests of other processes have cameras of the same numbers."""
    folder = tmp_path_factory.mktemp("locks")
    monkeypatch.setenv(FOLDER_VARIABLE, str(folder))
    return folder


@pytest.fixture
def clock() -> TurnedClock:
    return TurnedClock()


@pytest.fixture
def scripted() -> Iterator:
    """Make ports that follow a transcript; at the end of the test none of it may be left over."""
    ports: list[ScriptedPort] = []

    def make(pairs: list[tuple[bytes, bytes]]) -> ScriptedPort:
        ports.append(ScriptedPort(pairs))
        return ports[-1]

    yield make
    for port in ports:
        assert port.pairs == [], "a part of the transcript was never sent"
