"""Compiles loops in processes of their own, before a device opens and before they are used.

A process that compiles a loop itself may call another copy of it than one that reads it from the disk: stars then move
by some 1e-6 px.
"""

from __future__ import annotations

import functools
import importlib.metadata
import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import click

from bench.base.kernel_cache import kernel_folder, kernel_sources

STARS = "bench.measure.warm_up"
"""The program that compiles, by using each once, the loops that find stars in recordings and images."""
SIMULATOR = "simulators.warm_up"
"""The program that compiles the loops of the simulated cameras."""
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
"""The other processor has work of its own."""


@functools.cache
def compile_loops(*programs: str) -> None:
    """Let each program compile its loops, unless it has done so since the sources changed; tell it on standard error.

    What cannot be compiled beforehand is compiled when it is used.
    """
    missing = [program for program in programs if not _is_compiled(program)]
    if not missing:
        return
    click.echo(
        "Compiling loops for this processor, once after an installation or an update: half a minute to two minutes,"
        " longer on a busy computer.",
        err=True,
    )
    begun_s = time.monotonic()
    running = {
        program: subprocess.Popen(
            [sys.executable, "-m", program],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **_ONE_THREAD},
        )
        for program in missing
    }
    try:
        for program, process in running.items():
            done = process.wait() == 0
            if done:
                _keep_compiled(program)
            end = "compiled" if done else "could not be compiled beforehand"
            click.echo(f"  {program}: {end}, {time.monotonic() - begun_s:.0f} s", err=True)
    finally:
        for process in running.values():
            process.terminate()
            process.wait()


def _is_compiled(program: str) -> bool:
    try:
        return _record(program).read_text(encoding="utf-8") == _state()
    except OSError:
        return False


def _keep_compiled(program: str) -> None:
    with suppress(OSError):  # a folder that cannot be written: the program runs again for the next process
        _record(program).parent.mkdir(parents=True, exist_ok=True)
        _record(program).write_text(_state(), encoding="utf-8")


def _record(program: str) -> Path:
    """Return the file that says for which state of the sources a program has compiled its loops."""
    return kernel_folder(os.environ) / f"{program}.{sys.implementation.cache_tag}.compiled"


def _state() -> str:
    newest_ns = max(source.stat().st_mtime_ns for source in kernel_sources())
    return f"numba {importlib.metadata.version('numba')}, newest source {newest_ns}"
