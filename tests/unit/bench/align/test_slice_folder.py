"""The private folder of slices, and what a killed process leaves behind."""

import os
import subprocess
import sys

from bench.align import live_loop as slice_folder


def test_a_folder_is_private_and_those_of_dead_processes_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(slice_folder, "MEMORY", tmp_path)
    ended = subprocess.run(
        [sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True, text=True
    )
    left = tmp_path / f"starbench-align-{ended.stdout.strip()}-abc"
    living = tmp_path / f"starbench-align-{os.getppid()}-abc"
    other = tmp_path / "starbench-align-notes"
    for folder in (left, living, other):
        folder.mkdir()
    made = slice_folder.make_slice_folder()
    assert made.parent == tmp_path
    assert made.stat().st_mode & 0o077 == 0
    assert not left.exists()
    assert living.exists()
    assert other.exists()


def test_without_room_in_memory_the_folder_is_on_the_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(slice_folder, "MEMORY", tmp_path / "none")
    monkeypatch.setattr(slice_folder.tempfile, "gettempdir", lambda: str(tmp_path))
    assert slice_folder.make_slice_folder().parent == tmp_path
