"""Gates of a recording: what it must show to count, judged from facts alone.

Knows no device and no file; each refusal is a sentence that says what was found and what was wanted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from bench.records.events import GateData, MeasuredFacts
from drivers.camera import RecordingFacts
from sequences.script import Gates

Verdict = Literal["pass", "marginal", "fail"]

FREQUENCY_TOLERANCE = {"triggers": 0.001, "events": 0.005}
"""How far the flicker, by the camera's clock, may be from what was set: clocks differ by parts in 10 000, and a
period is known to some microseconds from trigger edges, less well from the events alone."""
LAG_PERIODS = (-0.28, 0.2)
"""When in the period the ON events may begin, counted from the sync signal's rise: of a sine they come from a quarter
before, as soon as the light grows, of a square in dim light a little after it. An inverted sync signal is half off."""
FILTERS_TO_DISABLE = ("afk", "stc", "trail", "erc")
MARGIN = 0.1
"""A value within this share of its limit passes, but only just: marginal."""


@dataclass(frozen=True)
class Gate:
    """One gate as it was judged."""

    name: str
    value: float
    unit: str
    limit: str
    verdict: Verdict

    def as_data(self) -> GateData:
        """Give the gate as results and journal carry it."""
        return {
            "name": self.name,
            "value": self.value,
            "unit": self.unit,
            "limit": self.limit,
            "verdict": self.verdict,
        }


def at_least(name: str, value: float, limit: float, unit: str) -> Gate:
    """Judge a value that must not be below its limit.

    >>> at_least("stars", 300, 40, "").verdict, at_least("stars", 42, 40, "").verdict, at_least("s", 9, 40, "").verdict
    ('pass', 'marginal', 'fail')
    """
    verdict: Verdict = "fail" if value < limit else "marginal" if value < limit * (1 + MARGIN) else "pass"
    return Gate(name, value, unit, f">= {limit:g}", verdict)


def at_most(name: str, value: float, limit: float, unit: str) -> Gate:
    """Judge a value that must not be above its limit.

    >>> at_most("rate", 99, 100, "Mev/s").verdict, at_most("rate", 101, 100, "Mev/s").verdict
    ('marginal', 'fail')
    """
    verdict: Verdict = "fail" if value > limit else "marginal" if value > limit * (1 - MARGIN) else "pass"
    return Gate(name, value, unit, f"<= {limit:g}", verdict)


def recording_gates(
    facts: RecordingFacts, gates: Gates, frequency_hz: float, measured: MeasuredFacts, stars: int
) -> list[Gate]:
    """Judge one recording by its numbers.

    Parameters
    ----------
    facts
        What the driver knows of it.
    gates
        What the sequence demands.
    frequency_hz
        What the light was set to.
    measured
        What the recording itself tells, as `measure` names it; what it cannot tell is absent or None, and not
        judged.
    stars
        Stars found.
    """
    rate_mev_s = facts.events / facts.duration_s / 1e6 if facts.duration_s > 0 else 0.0
    judged = [
        at_least("stars", stars, gates.min_stars, ""),
        at_most("event rate", rate_mev_s, gates.max_event_rate_mev_s, "Mev/s"),
    ]
    numbers = gate_values(facts, gates, frequency_hz, measured)
    limits = dict(gates.limits)
    if measured.get("flicker_source") in FREQUENCY_TOLERANCE:
        limits.setdefault("max_flicker_off_percent", 100 * FREQUENCY_TOLERANCE[measured["flicker_source"]])
    for name, limit in limits.items():
        which, fact = name.split("_", 1)
        if numbers.get(fact) is not None:
            judge = at_least if which == "min" else at_most
            judged.append(judge(_label(fact), float(numbers[fact]), limit, _unit(fact)))
    if numbers.get("flicker_lag_periods") is not None:
        judged.append(_in_phase(float(numbers["flicker_lag_periods"])))
    return judged


def gate_values(
    facts: RecordingFacts, gates: Gates, frequency_hz: float, measured: MeasuredFacts
) -> dict[str, Any]:
    """All numbers of a recording that a sequence may limit, by name; parameters as for `recording_gates`."""
    told = {**measured, **(measured.get("image") or {})}
    if gates.require_triggers and "triggers_expected" in measured:
        told["triggers_missed"] = abs(int(measured["triggers_expected"]) - int(measured["triggers_found"]))
    if measured.get("flicker_hz") is not None:
        told["flicker_off_percent"] = 100 * abs(float(measured["flicker_hz"]) / frequency_hz - 1.0)
    if facts.rate_controller_in and facts.rate_controller_out is not None:
        passed = facts.rate_controller_out / facts.rate_controller_in
        told["rate_controller_loss_percent"] = 100 * max(1.0 - passed, 0.0)
    return told


_LABELS = {"motion_px": "stars moved", "flicker_off_percent": "flicker off nominal"}
_UNITS = {"px": "px", "us": "us", "percent": "%"}


def _unit(fact: str) -> str:
    """Unit that a number's name ends with; none for shares and counts."""
    return _UNITS.get(fact.rpartition("_")[2], "")


def _label(fact: str) -> str:
    """Number's name in words."""
    stem, _, last = fact.rpartition("_")
    return _LABELS.get(fact, (stem if last in _UNITS else fact).replace("_", " "))


def _in_phase(lag_periods: float) -> Gate:
    """Judge whether the events rise with the sync signal, and not half a period off."""
    low, high = LAG_PERIODS
    verdict: Verdict = "pass" if low <= lag_periods <= high else "fail"
    return Gate("events after sync", lag_periods, "periods", f"{low:g} to {high:g}", verdict)


def solution_gates(limits: Mapping[str, float], found: Mapping[str, float]) -> list[Gate]:
    """Judge a calibration by the limits of its solve step.

    Parameters
    ----------
    limits
        The most each number may be, by name with its unit: ``rms_px``, ``sigma_r_mm``, ``sigma_k1``.
    found
        Numbers by name without unit (``rms``, ``sigma_r``); a model that was chosen without a parameter has none.

    Examples
    --------
    >>> [gate.verdict for gate in solution_gates({"rms_px": 0.2, "sigma_fx_px": 3}, {"rms": 0.05, "sigma_fx": 2.8})]
    ['pass', 'marginal']
    """
    judged = []
    for name, limit in limits.items():
        stem, _, unit = name.rpartition("_") if name.endswith(("_px", "_mm")) else (name, "", "")
        if stem in found:
            judged.append(at_most(stem.replace("_", " "), found[stem], limit, unit))
    return judged


def failed_gate_texts(judged: Sequence[Gate]) -> list[str]:
    """Say which gates failed, what was found and what was wanted."""
    return [
        f"{g.name} {g.value:.6g}{' ' + g.unit if g.unit else ''}, wanted {g.limit}"
        for g in judged
        if g.verdict == "fail"
    ]


def rejection_reasons(facts: RecordingFacts, gates: Gates, judged: Sequence[Gate]) -> list[str]:
    """Say why a recording does not count; empty when it does."""
    reasons = failed_gate_texts(judged)
    reasons += [f"data lost: {gap}" for gap in facts.gaps]
    eaten = [f for f in FILTERS_TO_DISABLE if facts.filters.get(f)]
    if eaten:
        reasons.append(f"on-chip filters were on: {', '.join(eaten)}")
    if gates.require_triggers and facts.triggers == 0:
        reasons.append("no sync triggers: check the cable from the light's sync output to the camera")
    if not facts.complete:
        reasons.append("the recording ended before its time")
    return reasons
