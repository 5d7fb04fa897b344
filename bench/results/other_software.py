"""How the program that made results differs from this one, as far as results.json and the journal state it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.results.results_content import software


def other_software(results: Mapping[str, Any], names: Sequence[str]) -> str:
    """Return in which of some parts of the software results were made by another program than this one.

    names: Keys of ``run.software``.
    Returns: ``numpy 2.1 (here 2.2)``, several with commas; empty if all are the same.
    """
    used, here = results["run"].get("software") or {}, software()
    return ", ".join(
        f"{name.replace('_', ' ')} {used.get(name, 'not stated')} (here {here[name]})"
        for name in names
        if used.get(name) != here[name]
    )


def other_program(used: Mapping[str, Any]) -> str:
    """Return how the program that made results differs from this one, in any part.

    Returns: The differing parts; empty if the programs are the same.
    """
    return other_software({"run": {"software": used}}, tuple(software()))
