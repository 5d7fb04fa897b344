"""Files outside of runs: the bench's own folder, the program's sources by hash, and its compiled kernels.

By the hashes a verification tells another program from changed evidence: a version number does not identify a working
copy.
"""

from __future__ import annotations

import functools
import hashlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, MutableMapping, Sequence
from contextlib import suppress
from pathlib import Path

HOME_VARIABLE = "STARBENCH_HOME"


def home_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of the bench's own files, which may not exist yet.

    It is ``$STARBENCH_HOME`` or, if that is not set, ``starbench`` in the user's configuration folder.

    >>> home_folder({"HOME": "/home/ada"}).as_posix()
    '/home/ada/.config/starbench'
    >>> home_folder({"STARBENCH_HOME": "/etc/starbench"}).as_posix()
    '/etc/starbench'
    """
    if own := environ.get(HOME_VARIABLE):
        return Path(own)
    if configuration := environ.get("XDG_CONFIG_HOME"):
        return Path(configuration) / "starbench"
    return Path(environ.get("HOME") or Path.home()) / ".config" / "starbench"


# numba keeps compiled functions beside the source, or else in the user's cache folder; without either, the import of
# such a function fails (documentation of numba, ``NUMBA_CACHE_DIR``). The folder for users who may write to neither
# must therefore be set before numba is imported.

VARIABLE = "NUMBA_CACHE_DIR"
_ROOT = Path(__file__).parents[2]
_BESIDE = _ROOT / "calib"
_LAST_KERNELS = {"stars": "edge_pixels.edge_scores", "simulator": "evt3_writer._write"}
PARTS = tuple(_LAST_KERNELS)
"""Parts of the program with compiled loops."""
_PACKAGES_WITH_KERNELS = ("calib", "drivers", "simulators")


def set_kernel_cache(environ: MutableMapping[str, str], *, beside: Path = _BESIDE) -> None:
    """Set ``NUMBA_CACHE_DIR``, for children too, if numba would find no folder to write to; one that is set stays.

    The folder is the user's own in the system's temporary one: a kernel is a program, and another user's must not run.
    """
    if environ.get(VARIABLE) or _may_write(beside / "__pycache__") or _may_write(_user_cache(environ)):
        return
    folder = Path(tempfile.gettempdir()) / f"starbench-kernels-{_user_name()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    private = not hasattr(os, "getuid") or (status.st_uid == os.getuid() and not status.st_mode & 0o077)
    usable = private and folder.is_dir() and not folder.is_symlink()
    environ[VARIABLE] = str(folder) if usable else tempfile.mkdtemp(prefix="starbench-kernels-")


def missing_parts(parts: Sequence[str], environ: Mapping[str, str], *, root: Path = _ROOT) -> tuple[str, ...]:
    """Return the parts whose loops nobody has compiled, by one of their last kernels (see `remove_stale_kernels`)."""
    if environ.get(VARIABLE):
        caches = [Path(environ[VARIABLE])]
    elif _may_write(root / "calib" / "__pycache__"):
        caches = [root / package for package in _PACKAGES_WITH_KERNELS]
    else:
        caches = [_user_cache(environ) / "numba"]
    ending = f"-*.py{sys.version_info.major}{sys.version_info.minor}.nbi"
    return tuple(
        part
        for part in parts
        if not any(any(cache.glob(f"**/{_LAST_KERNELS[part]}{ending}")) for cache in caches)
    )


def remove_stale_kernels(root: Path = _ROOT) -> int:
    """Remove compiled kernels older than their folder's source files, so that none is loaded; return how many.

    numba's own test fails at a class that was renamed, and misses a change of another compiled function that is called.
    """
    removed = 0
    caches = (
        cache for package in _PACKAGES_WITH_KERNELS for cache in (root / package).glob("**/__pycache__")
    )
    for cache in caches:
        indexes = list(cache.glob("*.nbi"))
        newest = (
            max((source.stat().st_mtime for source in cache.parent.glob("*.py")), default=0.0)
            if indexes
            else 0.0
        )
        for index in indexes:
            with suppress(OSError):
                orphaned = not (cache.parent / f"{index.name.partition('.')[0]}.py").exists()
                if orphaned or index.stat().st_mtime < newest:
                    index.unlink()
                    removed += 1
        for code in cache.glob("*.nbc"):  # numba writes the index first; x-1.py311.nbi names x-1.py311.1.nbc
            if not code.with_suffix("").with_suffix(".nbi").exists():
                with suppress(OSError):
                    code.unlink()
    return removed


def _user_cache(environ: Mapping[str, str]) -> Path:
    base = environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - Path's fails without a home
    return Path(base)


def _may_write(folder: Path) -> bool:
    """Return whether files can be made in a folder, or the folder itself if it does not exist yet."""
    existing = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    return existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)


def _user_name() -> str:
    return str(os.getuid()) if hasattr(os, "getuid") else "user"


_PACKAGES = ("bench", "calib", "drivers", "sequences", "simulators")
_REPORT = "bench/report"
_DRAWN_WITH = (
    "bench/record/stored_calibration.py",
    "calib/uncertainty/projection_uncertainty.py",
    "calib/model/camera.py",
    "calib/model/lens.py",
)
"""Modules of the engine that the plots use."""
_EXPORTED_WITH = (
    "bench/solve/exports.py",
    "calib/model/camera.py",
    "calib/model/lens.py",
)
_ENDINGS = frozenset({".py", ".j2", ".css"})
_SHOWN = 16


@functools.cache
def forms() -> dict[str, str]:
    """Return ``program``, ``report_form``, ``export_form``: 16 digits of the SHA-256 of these files and their names."""
    import bench

    root = Path(bench.__file__).parent.parent
    return {
        "program": hash_of_files(root, (path for package in _PACKAGES for path in _sources(root / package))),
        "report_form": hash_of_files(
            root, [*_sources(root / _REPORT), *(root / name for name in _DRAWN_WITH)]
        ),
        "export_form": hash_of_files(root, (root / name for name in _EXPORTED_WITH)),
    }


def differing_software(used: Mapping[str, str], here: Mapping[str, str]) -> str:
    """Return what of the software used differs here: ``numpy 2.1 (here 2.2)``, with commas."""
    return ", ".join(
        f"{name.replace('_', ' ')} {used.get(name, 'not stated')} (here {version})"
        for name, version in here.items()
        if used.get(name) != version
    )


def _sources(folder: Path) -> Iterable[Path]:
    return (path for path in folder.rglob("*") if path.suffix in _ENDINGS)


def hash_of_files(root: Path, files: Iterable[Path]) -> str:
    """Return 16 digits of the SHA-256 of source files and their names below a folder; line ends do not count."""
    digest = hashlib.sha256()
    for name, path in sorted((path.relative_to(root).as_posix(), path) for path in files):
        data = path.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{name} {len(data)}\n".encode() + data)
    return digest.hexdigest()[:_SHOWN]


_SAID_EVERY_S = 20.0
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
"""The other processor has work of its own."""


def compile_missing(parts: Sequence[str], say: Callable[[str], None]) -> None:
    """Compile what no process has compiled, each part in its own process; a part that fails is compiled when used."""
    missing = missing_parts(parts, os.environ)
    if not missing:
        return
    say(
        f"Compiling loops for this processor, once after an installation or an update ({' and '.join(missing)}): "
        "half a minute to two minutes, longer on a busy computer."
    )
    begun_s = said_s = time.monotonic()
    running = {
        part: subprocess.Popen(
            [sys.executable, "-m", "bench.warm_up", part],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **_ONE_THREAD},
        )
        for part in missing
    }
    try:
        while running:
            for part, process in list(running.items()):
                with suppress(subprocess.TimeoutExpired):
                    process.wait(0.2)
                    del running[part]
                    end = "compiled" if process.returncode == 0 else "could not be compiled beforehand"
                    say(f"  {part}: {end}, {time.monotonic() - begun_s:.0f} s")
            if running and time.monotonic() - said_s > _SAID_EVERY_S:
                said_s = time.monotonic()
                say(f"  {', '.join(running)}: still compiling, {said_s - begun_s:.0f} s ...")
    finally:
        for process in running.values():
            process.terminate()
            process.wait()
