"""Compiled kernels find a folder for every user, and never one that another user could have filled."""

import os
from pathlib import Path

import pytest
from running import python

from bench.base.kernel_cache import VARIABLE, remove_stale_kernels, set_kernel_cache

ROOT = Path(__file__).parents[4]


@pytest.fixture
def closed(tmp_path, monkeypatch):
    """Folders that cannot be written, whoever asks (root may write everywhere)."""
    folder = tmp_path / "closed"
    folder.mkdir()
    allowed = os.access
    monkeypatch.setattr(
        "os.access", lambda path, mode: not Path(path).is_relative_to(folder) and allowed(path, mode)
    )
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return folder


def test_where_both_usual_places_are_closed_a_private_folder_is_named_and_named_again(closed):
    environ = {"XDG_CACHE_HOME": str(closed)}
    set_kernel_cache(environ, beside=closed)
    folder = Path(environ[VARIABLE])
    assert folder.stat().st_mode & 0o777 == 0o700
    again = {"XDG_CACHE_HOME": str(closed)}
    set_kernel_cache(again, beside=closed)
    assert again[VARIABLE] == str(folder)


@pytest.mark.parametrize("usual", ["beside", "user", "told"])
def test_the_usual_place_is_left_where_there_is_one(closed, tmp_path, usual):
    environ = {"XDG_CACHE_HOME": str(tmp_path / "cache" if usual == "user" else closed)}
    if usual == "told":
        environ[VARIABLE] = "elsewhere"
    before = dict(environ)
    set_kernel_cache(environ, beside=tmp_path if usual == "beside" else closed)
    assert environ == before


@pytest.mark.parametrize("how", ["open to others", "a link", "another's"])
def test_a_folder_that_somebody_else_could_have_filled_is_not_used(closed, tmp_path, monkeypatch, how):
    us = os.getuid() + (how == "another's")
    monkeypatch.setattr("os.getuid", lambda: us)
    planted = tmp_path / f"starbench-kernels-{us}"
    if how == "a link":
        (tmp_path / "theirs").mkdir(mode=0o700)
        planted.symlink_to(tmp_path / "theirs")
    else:
        planted.mkdir()
        planted.chmod(0o777 if how == "open to others" else 0o700)
    environ = {"XDG_CACHE_HOME": str(closed)}
    set_kernel_cache(environ, beside=closed)
    named = Path(environ[VARIABLE])
    assert named != planted
    assert named.stat().st_mode & 0o777 == 0o700


def test_the_command_line_asks_before_numba_is_imported():
    program = (
        "import sys, bench.base.kernel_cache as k; k.set_kernel_cache = lambda e: print('numba' in sys.modules);"
        "from bench.commands.cli import main; main(['--version'])"
    )
    ended = python("-c", program, cwd=ROOT)
    assert ended.stdout.splitlines()[0] == "False"


def test_kernels_older_than_a_source_beside_them_are_removed(tmp_path):
    cache = tmp_path / "calib" / "events" / "__pycache__"
    cache.mkdir(parents=True)
    source = cache.parent / "flicker.py"
    source.touch()
    (cache.parent / "bursts.py").touch()
    os.utime(cache.parent / "bursts.py", (source.stat().st_mtime - 60,) * 2)
    for name, age_s in (("flicker.new-3", -10), ("flicker.old-9", 10), ("bursts.calls_old-4", 10)):
        for ending in ("nbi", "1.nbc", "2.nbc"):
            kernel = cache / f"{name}.py311.{ending}"
            kernel.touch()
            os.utime(kernel, (source.stat().st_mtime - age_s,) * 2)
    remove_stale_kernels(tmp_path)
    assert {path.name for path in cache.iterdir()} == {
        f"flicker.new-3.py311.{e}" for e in ("nbi", "1.nbc", "2.nbc")
    }
