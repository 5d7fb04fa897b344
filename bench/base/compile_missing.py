"""Compiles the loops that are missing, in processes of their own, before they are used."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from bench.base.kernel_cache import missing_parts

_SAID_EVERY_S = 20.0  # Shows that it works, in a log too
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
