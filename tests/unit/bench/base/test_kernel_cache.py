"""Compiled kernels find a folder for every user, and never one that another user could have filled."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench.base import compile_missing as compiling
from bench.base.kernel_cache import PARTS, VARIABLE, missing_parts, remove_stale_kernels, set_kernel_cache

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
    set_kernel_cache(environ, own_folder=closed)
    folder = Path(environ[VARIABLE])
    assert folder.stat().st_mode & 0o777 == 0o700
    again = {"XDG_CACHE_HOME": str(closed)}
    set_kernel_cache(again, own_folder=closed)
    assert again[VARIABLE] == str(folder)


@pytest.mark.parametrize("usual", ["beside", "user", "told"])
def test_the_usual_place_is_left_where_there_is_one(closed, tmp_path, usual):
    environ = {"XDG_CACHE_HOME": str(tmp_path / "cache" if usual == "user" else closed)}
    if usual == "told":
        environ[VARIABLE] = "elsewhere"
    before = dict(environ)
    set_kernel_cache(environ, own_folder=tmp_path if usual == "beside" else closed)
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
    set_kernel_cache(environ, own_folder=closed)
    named = Path(environ[VARIABLE])
    assert named != planted
    assert named.stat().st_mode & 0o777 == 0o700


def test_the_command_line_asks_before_numba_is_imported():
    program = (
        "import sys, bench.base.kernel_cache as k; k.set_kernel_cache = lambda e: print('numba' in sys.modules);"
        "from bench.commands.cli import main; main(['--version'])"
    )
    command = [sys.executable, "-c", program]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert ended.stdout.splitlines()[0] == "False"


def test_kernels_older_than_a_source_beside_them_or_without_one_are_removed(tmp_path):
    cache = tmp_path / "calib" / "events" / "__pycache__"
    cache.mkdir(parents=True)
    source = cache.parent / "flicker.py"
    source.touch()
    (cache.parent / "bursts.py").touch()
    os.utime(cache.parent / "bursts.py", (source.stat().st_mtime - 60,) * 2)
    names = ("flicker.new-3", "flicker.old-9", "bursts.calls_old-4", "gone.fold-1")
    fresh, stale, caller, orphan = (cache / f"{name}.py311.nbi" for name in names)
    for index, age_s in ((fresh, -10), (stale, 10), (caller, 10), (orphan, -10)):
        index.touch()
        os.utime(index, (source.stat().st_mtime - age_s,) * 2)
        index.with_suffix(".1.nbc").touch()
        index.with_suffix(".2.nbc").touch()
    assert remove_stale_kernels(tmp_path) == 3
    assert sorted(cache.iterdir()) == sorted(
        [fresh, fresh.with_suffix(".1.nbc"), fresh.with_suffix(".2.nbc")]
    )
    assert remove_stale_kernels(tmp_path / "nowhere") == 0


def test_parts_that_no_process_has_compiled_are_named(tmp_path):
    environ, version = {VARIABLE: str(tmp_path)}, f"py{sys.version_info.major}{sys.version_info.minor}"
    assert missing_parts(PARTS, environ) == PARTS
    (tmp_path / "stars_1").mkdir()
    (tmp_path / "stars_1" / f"edge_pixels.edge_scores-162.{version}.nbi").touch()
    assert missing_parts(PARTS, environ) == ("simulator",)
    assert missing_parts(("stars",), environ) == ()
    for kernel in (
        "calib/stars/__pycache__/edge_pixels.edge_scores",
        "simulators/pixels/__pycache__/evt3_writer._write",
    ):
        (tmp_path / kernel).parent.mkdir(parents=True)
        (tmp_path / f"{kernel}-1.{version}.nbi").touch()
    (tmp_path / "calib" / "__pycache__").mkdir()
    assert missing_parts(PARTS, {}, root=tmp_path) == ()  # beside their sources, in every package


def test_missing_parts_are_compiled_in_processes_of_their_own_and_told(monkeypatch):
    begun, messages, real = [], [], subprocess.Popen

    def begin(words, **options):
        begun.append(words[1:])
        return real([sys.executable, "-c", f"raise SystemExit({int(words[-1] == 'stars')})"], **options)

    monkeypatch.setattr(compiling, "missing_parts", lambda parts, _environ: tuple(parts))
    monkeypatch.setattr("subprocess.Popen", begin)
    compiling.compile_missing(("good", "stars"), messages.append)
    assert begun == [["-m", "bench.warm_up", part] for part in ("good", "stars")]
    assert messages[0].startswith(
        "Compiling loops for this processor, once after an installation or an update"
    )
    assert any(text.startswith("  good: compiled, ") for text in messages[1:])
    assert any(text.startswith("  stars: could not be compiled beforehand, ") for text in messages[1:])


def test_nothing_is_said_where_all_is_compiled(monkeypatch):
    monkeypatch.setattr(compiling, "missing_parts", lambda _parts, _environ: ())
    compiling.compile_missing(PARTS, pytest.fail)
