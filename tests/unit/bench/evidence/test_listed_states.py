"""States in a list: verified once while nothing that decides has changed, and never kept where they do not hold."""

import os
from datetime import UTC, datetime, timedelta

import pytest
from authorising import needs_ssh_keygen

from bench.evidence import listed_states as module
from bench.evidence.authorisation import authorise
from bench.evidence.key_trust import Trust
from bench.evidence.listed_states import listed_states
from bench.evidence.seal import seal
from tests.unit.bench.evidence.resealed import writable


@pytest.fixture
def reader(tmp_path):
    (tmp_path / "reader").mkdir()
    return tmp_path / "reader"


@pytest.fixture
def sealed(tmp_path, key, make_run):
    with make_run(tmp_path / "run") as folder:
        seal(folder, key)
    return folder.path


def later(seconds=60):
    """A list some time after the files were written: their times have settled."""
    return datetime.now(UTC) + timedelta(seconds=seconds)


def listed(folder, reader, now=None):
    return str(listed_states([str(folder)], reader, now or later())[str(folder)])


def change_last_byte(path):
    """Replace a file by one of the same size and time of change."""
    times, data = path.stat(), path.read_bytes()
    writable(path.parent)
    path.unlink()
    path.write_bytes(data[:-2] + bytes([data[-2] ^ 1]) + data[-1:])
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def test_a_seal_that_holds_is_verified_once(sealed, reader, monkeypatch):
    assert listed(sealed, reader) == "SEALED"
    monkeypatch.setattr(module, "shown_state", lambda *_: pytest.fail("it was verified again"))
    assert listed(sealed, reader) == "SEALED"


@pytest.mark.parametrize("name", ["SHA256SUMS", "SHA256SUMS.sig"])
def test_a_file_replaced_by_one_of_the_same_size_and_time_is_noticed(sealed, reader, name):
    assert listed(sealed, reader) == "SEALED"
    change_last_byte(sealed / name)
    assert listed(sealed, reader) == listed(sealed, reader) == "DRAFT"


def test_what_was_written_a_moment_ago_is_verified_again(sealed, reader, monkeypatch):
    assert listed(sealed, reader, datetime.now(UTC)) == "SEALED"
    asked = []
    monkeypatch.setattr(
        module, "shown_state", lambda folder, *_: asked.append(folder) or pytest.fail("asked")
    )
    with pytest.raises(pytest.fail.Exception):
        listed(sealed, reader)
    assert asked == [sealed]


@needs_ssh_keygen
def test_an_authorisation_counts_while_its_key_is_trusted(sealed, reader, signers, ada):
    assert listed(sealed, reader) == "SEALED"
    authorise(sealed, ada[0], Trust((*signers, ada[1])), datetime.now(UTC))
    assert listed(sealed, reader) == "SEALED"
    (reader / "allowed_signers").write_text(f"{ada[1].line}\n")
    assert listed(sealed, reader) == listed(sealed, reader) == "AUTHORISED"
    (reader / "allowed_signers").write_text("")
    assert listed(sealed, reader) == "SEALED"


def test_a_list_tells_how_many_are_judged(sealed, reader):
    counts = []
    listed_states([str(sealed)], reader, later(), counts.append)
    listed_states([str(sealed)], reader, later(), counts.append)
    assert counts == [0, 1, 1]
