"""The front door of Starbench: `import starbench` for notebooks, and the `starbench` command.

The build copies this folder into site-packages as the package ``starbench`` (docs/decisions/0025). The names of the
five folders of Starbench are common words; the name ``starbench`` belongs to Starbench alone. The front door therefore
imports nothing else of Starbench until it is used, and first checks that the five packages lie side by side.

==========================  ============================================================================
`load`                      read a solved run: camera, covariance, views, poses, results
`Run`, `Pose`               what `load` returns
==========================  ============================================================================

Everything else is in `calib`: ``from calib import calibrate, CalibrationOptions``. docs/python.md shows an example.
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any

from .own_packages import ForeignPackageError, require_own_packages

if TYPE_CHECKING:
    from bench import __version__
    from bench.solve.run_reader import Pose, Run, load

__all__ = ["ForeignPackageError", "Pose", "Run", "__version__", "load"]

_MODULES = {
    "Pose": "bench.solve.run_reader",
    "Run": "bench.solve.run_reader",
    "load": "bench.solve.run_reader",
    "__version__": "bench",
}
_STOPPED_BY_CTRL_C = 128 + 2  # As shells have it: 128 and the number of SIGINT


def __getattr__(name: str) -> Any:
    """Load a name when it is first used (PEP 562), after a check of the five packages."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    require_own_packages()
    value = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, also those that are not loaded yet."""
    return sorted(__all__)


def main() -> None:
    """Run the command line and exit; refuse first if one of the five packages is not the one of Starbench."""
    try:
        require_own_packages()
        from bench.commands.cli import main as run_command_line

        run_command_line()
    except ForeignPackageError as error:
        if "--json" in sys.argv:
            import json

            shown = {"kind": type(error).__name__, "message": str(error), "remedy": error.remedy}
            sys.stdout.write(json.dumps({"error": shown}, indent=1) + "\n")
        sys.stderr.write(f"starbench: {error}\n")
        sys.exit(1)
    except KeyboardInterrupt:  # while the program still loads: one line, no traceback
        sys.stderr.write("Stopped.\n")
        sys.exit(_STOPPED_BY_CTRL_C)
