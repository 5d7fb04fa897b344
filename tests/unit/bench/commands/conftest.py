"""Fixtures that run a command in a folder of its own, and give what it prints."""

import pytest
from calling import ended


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def say(capsys, here):
    def called(*words):
        status, captured = ended(capsys, *words)
        return status, captured.out, captured.err

    return called
