"""The folder in which numba keeps the compiled loops, set before numba is imported.

numba keeps compiled functions beside the source, or else in the user's cache folder; without either, the import of
such a function fails (documentation of numba, ``NUMBA_CACHE_DIR``). So users who may write to neither get a folder.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, MutableMapping
from contextlib import suppress
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
_ROOT = Path(__file__).parents[2]
_BESIDE = _ROOT / "calib" / "__pycache__"
_PACKAGES_WITH_KERNELS = ("calib", "drivers", "simulators")


def set_kernel_cache(environ: MutableMapping[str, str], *, beside: Path = _BESIDE) -> None:
    """Set ``NUMBA_CACHE_DIR``, for children too, if numba would find no folder to write to; one that is set stays.

    The folder is the user's own in the system's temporary one: a kernel is a program, and another user's must not run.
    """
    if environ.get(VARIABLE) or _may_write(beside) or _may_write(_user_cache(environ)):
        return
    import tempfile

    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"starbench-kernels-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    private = not hasattr(os, "getuid") or (status.st_uid == os.getuid() and not status.st_mode & 0o077)
    usable = private and folder.is_dir() and not folder.is_symlink()
    environ[VARIABLE] = str(folder) if usable else tempfile.mkdtemp(prefix="starbench-kernels-")


def kernel_folder(environ: Mapping[str, str]) -> Path:
    """Return the folder of the compiled loops: the one that is set; else that beside a source, or the user's."""
    if environ.get(VARIABLE):
        return Path(environ[VARIABLE])
    return _BESIDE if _may_write(_BESIDE) else _user_cache(environ)


def kernel_sources() -> Iterator[Path]:
    """Return the source files of the packages with compiled loops."""
    return (source for package in _PACKAGES_WITH_KERNELS for source in (_ROOT / package).rglob("*.py"))


def remove_stale_kernels(root: Path = _ROOT) -> None:
    """Remove compiled kernels older than a source file of their folder, so that none is loaded.

    numba's own test fails at a class that was renamed, and misses a change of another compiled function that is called.
    """
    for cache in (
        cache for package in _PACKAGES_WITH_KERNELS for cache in (root / package).glob("**/__pycache__")
    ):
        kernels = list(cache.glob("*.nb[ic]"))
        sources = cache.parent.glob("*.py") if kernels else ()
        newest = max((source.stat().st_mtime for source in sources), default=0.0)
        for kernel in kernels:
            with suppress(OSError):
                if kernel.stat().st_mtime < newest:
                    kernel.unlink()


def _user_cache(environ: Mapping[str, str]) -> Path:
    base = environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - Path's fails without a home
    return Path(base)


def _may_write(folder: Path) -> bool:
    """Return whether files can be made in a folder, or the folder itself if it does not exist yet."""
    existing = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    return existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)
