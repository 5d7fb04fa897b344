"""Where compiled kernels are kept, for users who may write neither beside the program nor into their home.

Knows numba's rule (beside the source, else in the user's cache folder, else an error at import) and the environment's
variables; must be asked before numba is imported. Writes nothing but a private folder.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import MutableMapping
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
_BESIDE = Path(__file__).parents[2] / "calib"


def set_kernel_cache(environ: MutableMapping[str, str], *, beside: Path = _BESIDE) -> None:
    """Name a folder for compiled kernels where numba would find none.

    It is one of the user's own in the system's folder for temporary files, kept for the next call; where somebody else
    has taken its name, a new one, for a kernel is a program, and another's must not be run.

    Parameters
    ----------
    environ
        The process's environment; ``NUMBA_CACHE_DIR`` is set in it, for child processes too, unless it is already.
    beside
        Folder of sources with kernels.

    Raises
    ------
    OSError
        When no folder can be made.
    """
    if environ.get(VARIABLE) or _may_write(beside / "__pycache__") or _may_write(_users(environ)):
        return
    folder = Path(tempfile.gettempdir()) / f"starbench-kernels-{_who()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    told = folder.lstat()
    private = not hasattr(os, "getuid") or (told.st_uid == os.getuid() and not told.st_mode & 0o077)
    usable = private and folder.is_dir() and not folder.is_symlink()
    environ[VARIABLE] = str(folder) if usable else tempfile.mkdtemp(prefix="starbench-kernels-")


def _users(environ: MutableMapping[str, str]) -> Path:
    base = environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - Path's fails without a home
    return Path(base)


def _may_write(folder: Path) -> bool:
    """Tell whether files can be made in a folder, or the folder itself where it is not there yet."""
    there = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _who() -> str:
    return str(os.getuid()) if hasattr(os, "getuid") else "user"
