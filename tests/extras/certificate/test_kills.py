"""Processes that write evidence, killed between two storage calls: nothing is lost, and the next command ends the work."""

import os
import shutil
import signal
import sys
import traceback

import pytest
from certificate_lab import FIRST

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")]

KILLS = 10
"""Kills of each kind of work, spread over its storage calls."""
STORES = {"os.rename", "os.remove", "os.mkdir", "os.chmod", "os.link", "os.truncate", "fcntl.flock"}


def is_store(event, arguments):
    if event == "open":
        return bool(arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
    return event in STORES


def killed_at(work, number):
    """Do the work in a child that is killed just before a storage call; return the count of calls, or -1 if killed."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        count = 0

        def watch(event, arguments):
            nonlocal count
            if is_store(event, arguments):
                count += 1
                if count == number:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(watch)
        code = 1
        try:
            work()
            os.write(writing, str(count).encode())
            code = 0
        except BaseException:  # noqa: BLE001 - the parent must not go on twice
            traceback.print_exc()
        finally:
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        count_text = stream.read()
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) == signal.SIGKILL
        return -1
    assert os.WEXITSTATUS(status) == 0
    return int(count_text)


def kills_of(work, folder, backup):
    """Yield after each kill, spread over the storage calls of the work; the folder is put back before each."""
    shutil.copytree(folder, backup, copy_function=shutil.copy2)

    def put_back():
        for path in (folder, *folder.rglob("*")):
            path.chmod(0o755)
        shutil.rmtree(folder)
        shutil.copytree(backup, folder, copy_function=shutil.copy2)

    count = killed_at(work, 0)
    assert count >= 3
    for kill in range(KILLS):
        put_back()
        assert killed_at(work, 1 + kill * count // KILLS) == -1
        yield kill
    put_back()


def test_a_ledger_killed_anywhere_has_no_gap_and_takes_the_run_again(lab):
    def begin():
        return lab.ledger.begin(run_id="run8", folder=lab.run, camera="00050423", simulated=True)

    for _ in kills_of(begin, lab.home, lab.path.parent / f"{lab.path.name}-backup"):
        number = begin()["number"]
        assert [run.number for run in lab.ledger.runs()] == list(range(1, number + 1))
        assert lab.ledger.breaks() == ([], [])


def test_a_certificate_killed_anywhere_has_one_number(lab):
    for kill in kills_of(lab.issue, lab.path, lab.path.parent / f"{lab.path.name}-backup"):
        whole = (lab.path / "certificate").exists()
        issued = lab.issue("again", **({"also": "whole"} if whole else {}))
        assert issued.certificate.number == FIRST or whole, kill
        states = lab.numbers()
        assert set(states.values()) == {"issued"}, (kill, states)
        assert len(states) == 1 + whole
        assert [path.name for path in lab.path.iterdir() if path.name.endswith(".tmp")] == []
