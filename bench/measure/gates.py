"""Gates of a recording: limits to be accepted, judged from numbers alone; a reason has what was found and needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from drivers.camera import RecordingFacts
from sequences.schema import GateConfig, Waveform
from sequences.script import Gates

if TYPE_CHECKING:
    from bench.record.measured_facts import MeasuredFacts

Verdict = Literal["pass", "marginal", "fail"]

FREQUENCY_TOLERANCE = {"triggers": 0.001, "events": 0.005}
"""Largest relative difference between the flicker by the camera's clock and its nominal frequency. Clocks differ by
parts in 10 000; trigger edges give the period to some microseconds, events alone give it less well."""
LAG_PERIODS = (-0.28, 0.2)
"""Range of the time from the sync signal's rising edge to the first ON events, periods. With a sine the ON events begin
up to a quarter period before, when the light begins to grow; with a square wave in dim light they begin shortly after.
An inverted sync signal shifts them by half a period."""
FILTERS_TO_DISABLE = ("afk", "stc", "trail", "erc")
"""On-chip filters that remove events of the flicker."""
_SILENT = (
    "they are dead, or missed by the readout: lower the event rate; if the same ones stay, it is the sensor"
)
ADVICE = {
    "event rate": "for fewer events, lower the light's frequency_hz or level_percent, or raise bias_diff_on and "
    "bias_diff_off; if the camera carries them, set a higher max_event_rate_mev_s",
    "data rate": "for less data, use a square flicker, or lower both frequency_hz and level_percent of the sine",
    "edge width": "the image is out of focus; focus the lens",
    "triggers missed": "edges of the sync signal were lost: check its cable, its plugs and its level",
    "trigger jitter": "the edges of the sync signal are not regular: check its cable, and that it comes from the light",
    "events after sync": "the sync signal is inverted, or not that of the light: check the sync output and its cable",
    "flicker disagreement": "events do not follow the sync signal alone: look for another light that flickers, such "
    "as a lamp on the mains",
    "stars moved": "wait longer before recording, and look for a fan or a pump that shakes the bench",
    "silent rows": _SILENT,
    "silent columns": _SILENT,
    "flicker off nominal": "the light does not flicker as set: compare its frequency_hz with what its driver shows",
}
"""What to do if a gate fails, by its name."""
MARGIN = 0.1
"""A value that passes but is within this share of its limit is marginal."""
_LABELS = {
    "motion_px": "stars moved",
    "flicker_off_percent": "flicker off nominal",
    "data_rate_gbit_s": "data rate",
}
_UNITS = {"px": "px", "us": "us", "percent": "%"}


@dataclass(frozen=True)
class Gate:
    """One gate as judged."""

    name: str
    value: float
    unit: str  # Its unit; empty for a pure number
    limit: str  # The limit as text, such as ``>= 40``
    verdict: Verdict  # ``pass``, ``marginal`` or ``fail``


def at_least(name: str, value: float, limit: float, unit: str) -> Gate:
    """Judge a value that must not be below its limit; the unit is empty for a pure number.

    >>> at_least("stars", 300, 40, "").verdict, at_least("stars", 42, 40, "").verdict, at_least("s", 9, 40, "").verdict
    ('pass', 'marginal', 'fail')
    """
    verdict: Verdict = "fail" if value < limit else "marginal" if value < limit * (1 + MARGIN) else "pass"
    return Gate(name, value, unit, f">= {limit:g}", verdict)


def at_most(name: str, value: float, limit: float, unit: str) -> Gate:
    """Judge a value that must not be above its limit; the unit is empty for a pure number.

    >>> at_most("rate", 99, 100, "Mev/s").verdict, at_most("rate", 101, 100, "Mev/s").verdict
    ('marginal', 'fail')
    """
    verdict: Verdict = "fail" if value > limit else "marginal" if value > limit * (1 - MARGIN) else "pass"
    return Gate(name, value, unit, f"<= {limit:g}", verdict)


def looser_gates(gates: Gates, waveform: Waveform) -> list[str]:
    """Return a sentence for each gate that accepts more than its default under this waveform of the light."""
    stated, usual = _limits(gates), _limits(Gates.from_settings(dict(GateConfig()), waveform))
    looser = [
        f"The gate {name} was {stated[name]:g}, looser than its default {limit:g}."
        for name, limit in usual.items()
        if (stated[name] < limit if name.startswith("min_") else stated[name] > limit)
    ]
    if not gates.require_triggers:
        looser.append("The gate require_triggers was off.")
    return looser


def _limits(gates: Gates) -> dict[str, float]:
    rate = gates.max_event_rate_mev_s
    return {"min_stars": gates.min_stars, "max_event_rate_mev_s": rate, **gates.limits}


def recording_gates(
    facts: RecordingFacts, gates: Gates, frequency_hz: float, measured: MeasuredFacts, stars: int
) -> list[Gate]:
    """Judge one recording by its numbers, as `bench.measure.measure.measure` has them; None is not judged."""
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
    """Return all numbers of a recording that a sequence may limit."""
    values = {**measured, **(measured.get("image") or {})}
    if gates.require_triggers and "triggers_expected" in measured:
        values["triggers_missed"] = abs(int(measured["triggers_expected"]) - int(measured["triggers_found"]))
    if measured.get("flicker_hz") is not None:
        values["flicker_off_percent"] = 100 * abs(float(measured["flicker_hz"]) / frequency_hz - 1.0)
    if facts.duration_s > 0:
        values["data_rate_gbit_s"] = 8e-9 * facts.bytes / facts.duration_s
    if facts.rate_controller_in and facts.rate_controller_out is not None:
        passed = facts.rate_controller_out / facts.rate_controller_in
        values["rate_controller_loss_percent"] = 100 * max(1.0 - passed, 0.0)
    return values


def _unit(fact: str) -> str:
    """Return the unit that a number's name ends with; empty for shares and counts."""
    if fact.endswith("_gbit_s"):
        return "Gbit/s"
    return _UNITS.get(fact.rpartition("_")[2], "")


def _label(fact: str) -> str:
    """Return a number's name as text."""
    stem, _, last = fact.rpartition("_")
    return _LABELS.get(fact, (stem if last in _UNITS else fact).replace("_", " "))


def _in_phase(lag_periods: float) -> Gate:
    """Judge whether the events begin with the sync signal, and not half a period away."""
    low, high = LAG_PERIODS
    verdict: Verdict = "pass" if low <= lag_periods <= high else "fail"
    return Gate("events after sync", lag_periods, "periods", f"{low:g} to {high:g}", verdict)


def solution_gates(limits: Mapping[str, float], values: Mapping[str, float]) -> list[Gate]:
    """Judge a calibration by the limits of its solve step, such as ``rms_px``, ``sigma_r_mm``, ``sigma_k1``.

    ``values`` has the names without unit (``rms``, ``sigma_r``). A parameter that the chosen model lacks is absent.

    >>> [gate.verdict for gate in solution_gates({"rms_px": 0.2, "sigma_fx_px": 3}, {"rms": 0.05, "sigma_fx": 2.8})]
    ['pass', 'marginal']
    """
    judged = []
    for name, limit in limits.items():
        stem, _, unit = name.rpartition("_") if name.endswith(("_px", "_mm")) else (name, "", "")
        if stem in values:
            judged.append(at_most(stem.replace("_", " "), values[stem], limit, unit))
    return judged


def failed_gate_texts(judged: Sequence[Gate]) -> list[str]:
    """Return which gates failed, with the value found, the limit and, where it is known, what to do."""
    return [
        f"{g.name} {g.value:.6g}{' ' + g.unit if g.unit else ''}, needed {g.limit}"
        f"{f' ({ADVICE[g.name]})' if g.name in ADVICE else ''}"
        for g in judged
        if g.verdict == "fail"
    ]


def rejection_reasons(facts: RecordingFacts, gates: Gates) -> list[str]:
    """Return why a recording is rejected, besides its failed gates; empty if nothing else is wrong."""
    reasons = [f"data lost: {gap}" for gap in facts.gaps]
    active = [f for f in FILTERS_TO_DISABLE if facts.filters.get(f)]
    if active:
        reasons.append(f"on-chip filters were on: {', '.join(active)}")
    if gates.require_triggers and facts.triggers == 0:
        reasons.append("no sync triggers: check the cable from the light's sync output to the camera")
    if not facts.complete:
        reasons.append("the recording ended too early")
    return reasons
