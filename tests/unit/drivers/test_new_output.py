"""A new file or folder has one writer, and appears whole or not at all, whatever ended the one before."""

import os
from pathlib import Path

import pytest

from drivers import new_output as module
from drivers.new_output import discard_unfinished, is_free, new_output, unfinished


@pytest.fixture(params=["file", "folder"])
def write(request):
    """Writes an output of either kind."""

    def write_at(path, text):
        if request.param == "folder":
            path.mkdir()
            (path / "inside").write_text(text)
            path.chmod(0o555)
        else:
            path.write_text(text)

    return write_at


def content(path):
    return (path / "inside" if path.is_dir() else path).read_text()


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def end_as_if_killed_at(monkeypatch, function, path, write, text):
    """Write an output in another process, which ends at a function of the module, before or after it is called."""
    when, name = function
    child = os.fork()
    if child == 0:
        real = getattr(module, name)

        def end(*arguments):
            if when == "after":
                real(*arguments)
            os._exit(9)

        setattr(module, name, end)
        with new_output(path) as part:
            write(part, text)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9


KILLED = [("before", "_give_name"), ("after", "_give_name"), ("before", "_give_up"), ("after", "_claimed")]


@pytest.mark.parametrize("function", KILLED, ids=" ".join)
def test_what_a_killed_process_left_does_not_stop_the_next_one(tmp_path, monkeypatch, write, function):
    path = tmp_path / "out"
    end_as_if_killed_at(monkeypatch, function, path, write, "first")
    assert is_free(path)
    with new_output(path) as part:
        write(part, "second")
    assert (content(path), names(tmp_path)) == ("second", ["out"])
    assert not is_free(path)


def test_a_file_of_another_program_is_not_taken_for_what_a_killed_process_left(tmp_path, monkeypatch, write):
    path = tmp_path / "out"
    end_as_if_killed_at(monkeypatch, ("before", "_give_up"), path, write, "first")
    path.rename(tmp_path / "moved")
    path.write_text("theirs")
    assert not is_free(path)
    with pytest.raises(FileExistsError), new_output(path):
        pytest.fail("it was begun")
    assert (path.read_text(), names(tmp_path)) == ("theirs", ["moved", "out"])


def test_a_second_writer_of_a_name_is_refused_and_told_who_has_it(tmp_path, write):
    path = tmp_path / "out"
    with new_output(path) as part:
        with pytest.raises(BlockingIOError, match=f"process {os.getpid()}"), new_output(path):
            pytest.fail("it was begun")
        with pytest.raises(BlockingIOError):
            discard_unfinished(path)
        write(part, "first")
    assert (content(path), names(tmp_path)) == ("first", ["out"])


def test_a_name_that_cannot_be_made_durable_is_taken_back(tmp_path, monkeypatch, write):
    def fail(_folder):
        raise OSError(5, "Input/output error")

    path = tmp_path / "out"
    with pytest.raises(OSError, match="Input/output"), new_output(path) as part:  # noqa: PT012 - the end raises
        write(part, "first")
        monkeypatch.setattr(module, "sync_folder", fail)
        monkeypatch.setattr(module, "sync_file", lambda _path: None)
    assert names(tmp_path) == []


def test_an_empty_folder_is_filled_and_that_of_the_process_itself_is_not(tmp_path, monkeypatch):
    (tmp_path / "out").mkdir()
    with new_output(tmp_path / "out") as part:
        part.mkdir()
        (part / "inside").touch()
    assert names(tmp_path / "out") == ["inside"]
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert not is_free(Path.cwd())


def test_what_a_killed_process_left_is_discarded(tmp_path, monkeypatch, write):
    path = tmp_path / "out"
    end_as_if_killed_at(monkeypatch, ("before", "_give_name"), path, write, "first")
    assert unfinished(path).exists()
    discard_unfinished(path)
    discard_unfinished(tmp_path / "none" / "out")
    assert names(tmp_path) == []
