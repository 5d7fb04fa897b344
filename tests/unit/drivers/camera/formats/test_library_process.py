"""Files that a library reads in another process: one message for whatever the library does."""

import resource
import sys

import numpy as np
import pytest
from imported import import_events

from drivers.camera.formats import library_process
from drivers.camera.formats.event_files import open_events
from drivers.errors import NotARecording


@pytest.fixture
def npz(tmp_path):
    """A good file of NumPy, with one event."""
    names = ("t", "x", "y", "p", "trigger_t", "trigger_value", "trigger_id")
    np.savez(tmp_path / "a.npz", **dict.fromkeys(names, np.zeros(1, int)), size=np.array([1280, 720]))
    return tmp_path / "a.npz"


def instead(monkeypatch, tmp_path, program):
    """Let another program do what the library would do."""
    (tmp_path / "stand_in").write_text(f"#!{sys.executable}\n{program}\n")
    (tmp_path / "stand_in").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "stand_in"))


@pytest.mark.parametrize(
    ("program", "what"),
    [
        ("import os; os.abort()", "more than 2 GiB of memory, or crashes its library"),
        ("import time; time.sleep(60)", "takes longer than 1 s"),
        ("print('x' * 1000)", "more than 2 GiB of memory"),
        ("import sys; sys.stdout.buffer.write(bytes([2]) + bytes(11) + b'{}')", "more than 2 GiB"),
    ],
)
def test_a_library_that_crashes_hangs_or_babbles_is_told(npz, tmp_path, monkeypatch, program, what):
    instead(monkeypatch, tmp_path, program)
    monkeypatch.setattr(library_process, "PATIENCE_S", 1.0)
    with pytest.raises(NotARecording, match=what):
        import_events(npz)


def test_a_process_is_gone_when_the_file_is_closed(npz, monkeypatch, tmp_path):
    import_events(npz)
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    with open_events(npz) as source:
        assert source.count == 1
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime > before  # it was waited for
