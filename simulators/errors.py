"""All errors that the simulators raise. Each says what is wrong, where, and what to do.

SimulatorError
├── ConfigError        an invalid key or value in the simulation's configuration
└── SimulationMisuse   a call that makes no physical sense: time going back, an array of the wrong shape
"""

from __future__ import annotations


class SimulatorError(Exception):
    """Base class; ``where`` is a key, file or port, ``remedy`` a sentence what to do; both may be empty."""

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = _one_stop(what)
        self.where = where
        self.remedy = remedy
        place = f"{where}: " if where else ""
        advice = f" {remedy}" if remedy else ""
        super().__init__(f"{place}{self.what}{advice}")


def _one_stop(text: str) -> str:
    """Return a text with one full stop at its end, where it has two because it ends with a quoted sentence."""
    return text[:-1] if text.endswith("..") and not text.endswith("...") else text


class ConfigError(SimulatorError):
    """An invalid key or value of the configuration; ``where`` names the key."""


class SimulationMisuse(SimulatorError):
    """A call that makes no physical sense."""
