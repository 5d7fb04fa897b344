"""Every error the simulators raise; each says what is wrong, where, and what to do.

SimulatorError
├── ConfigError        a key or a value of the simulation's configuration
└── SimulationMisuse   a call that makes no physical sense: time going back, an array of the wrong shape
"""

from __future__ import annotations


class SimulatorError(Exception):
    """What is wrong, where, and what to do about it."""

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = what
        self.where = where
        self.remedy = remedy
        place = f"{where}: " if where else ""
        advice = f" {remedy}" if remedy else ""
        super().__init__(f"{place}{what}{advice}")


class ConfigError(SimulatorError):
    """A key or a value of the configuration that cannot be used; ``where`` names the key."""


class SimulationMisuse(SimulatorError):
    """A call that makes no physical sense."""
