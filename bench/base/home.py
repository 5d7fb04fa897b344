"""The bench's own folder, outside of runs: keys, ledger, outbox."""

from __future__ import annotations

import os
from collections.abc import Mapping
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


def expand_home(path: str) -> str:
    """Return a path with the user's folder for ``~/`` at its begin, which shells leave alone in ``--output=~/run``."""
    return os.path.expanduser(path) if path.startswith("~/") else path  # noqa: PTH111 - Path's fails without a home
