"""The options that say who does the work of a command: this computer's processors, or the workers of a scheduler."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from bench.cluster.work import Workers

_Command = TypeVar("_Command", bound=Callable[..., Any])
_MEMORY = re.compile(r"(\d+(?:\.\d+)?)\s*(M|G)i?B?", re.IGNORECASE)
_UNITS = {"M": 1 << 20, "G": 1 << 30}
_LEAST_BYTES = 1 << 30


class _Memory(click.ParamType):
    """A size as 4GB or 1500M."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """See `click.ParamType.convert`."""
        if isinstance(value, int):
            return value
        found = _MEMORY.fullmatch(str(value).strip())
        size = int(float(found[1]) * _UNITS[found[2].upper()]) if found else 0
        if size < _LEAST_BYTES:
            self.fail(f"{value!r} is not a size of at least 1GB. Write it as 4GB or 1500MB.", param, ctx)
        return size


_OPTIONS = (
    click.option(
        "--scheduler",
        metavar="ADDRESS",
        help="Use the workers of this Dask scheduler: tcp://host:8786 or tls://host:8786 (docs/cluster.md).",
    ),
    click.option(
        "--workers",
        type=click.IntRange(1, 1024),
        metavar="N",
        help="Number of processes on this computer.  [default: one for each processor]",
    ),
    click.option(
        "--memory",
        type=_Memory(),
        default="4GB",
        show_default=True,
        help="Memory that each process on this computer may use.",
    ),
)


def worker_options(command: _Command) -> _Command:
    """Add ``--scheduler``, ``--workers`` and ``--memory`` to a command."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def open_workers(
    scheduler: str | None, workers: int | None, memory: int, *, most: int | None = None
) -> Workers:
    """Return who does the work.

    scheduler: Address of a Dask scheduler; None for processes on this computer.
    workers: Number of processes; None for one for each processor.
    memory: Memory that each process may use, bytes.
    most: Number of pieces of work, if it is known: no more processes are started. A single piece is done by
      the command itself, unless a number of processes is asked for.
    Returns: They must be closed.
    Raises UsageError: If both are given, or Dask is not installed.
    Raises WorkersLost: If nobody answers at the address.
    """
    from bench.base.errors import UsageError

    if scheduler is not None and workers is not None:
        raise UsageError(
            "The workers of a scheduler are not started here.",
            where="--workers",
            remedy="Leave out --workers or --scheduler.",
        )
    if scheduler is not None:
        from bench.cluster.scheduler import DaskWorkers

        return DaskWorkers(scheduler)
    from bench.cluster.processes import Processes, processors
    from bench.cluster.work import Serial

    count = min(workers or processors(), max(1, most) if most is not None else 1024)
    return Serial() if count == 1 and workers is None else Processes(count, memory)
