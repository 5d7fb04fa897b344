"""Commands of the program, called in this process."""

import pytest

from bench.commands.cli import main


def ended(capsys, *words):
    """Call a command, which must end without a traceback; return its exit status and what it said, `out` and `err`."""
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return end.value.code or 0, captured


def call(capsys, *words, status=0):
    """Call a command, which must end with a status; return what it said, `out` and `err`."""
    code, captured = ended(capsys, *words)
    assert code == status, captured.err
    return captured


def out_of(capsys, *words, status=0):
    """Call a command; return what it printed."""
    return call(capsys, *words, status=status).out


def refusal(capsys, *words, status=1):
    """Call a command that must fail; return what it said on standard error."""
    return call(capsys, *words, status=status).err
