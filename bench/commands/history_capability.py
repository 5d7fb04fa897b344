"""The gauge study of `history capability`: repeatability, reproducibility and, with limits, capability."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from bench.base.encoding import counted
from bench.base.errors import UsageError
from bench.base.home import home_folder
from bench.charts.statistics import (
    PART,
    REPEATABILITY,
    Capability,
    GaugeStudy,
    capability,
    plural,
    study,
)
from bench.commands.output import print_findings, show
from bench.extras.history.merged_runs import MergedRuns
from bench.record.run_facts import IndexedRun, RunDetails, RunPlace
from bench.record.run_index import RunIndex
from bench.wording.numbers import number
from bench.wording.parameters import unit_text
from calib.model.camera import PINHOLE
from calib.model.lens import BROWN, FISHEYE

_OF_THE_CAMERA = {*PINHOLE, *BROWN, *FISHEYE}
_OF_TERM = ("sum_of_squares", "degrees_of_freedom", "mean_square", "f", "p")
_OF_STUDY = ("repeatability", "reproducibility", "gauge", "total", "gauge_percent", "categories", "verdict")
_OF_CAPABILITY = ("cp", "cpk", "tolerance_percent")
_HEADS = ("", "unit", "EV", "AV", "GRR", "PV", "TV", "%GRR", "ndc", "%tol", "Cp", "Cpk")


@dataclass(frozen=True)
class _Run:
    """A run with a result, and what it has in common with others."""

    run: IndexedRun
    details: RunDetails
    place: RunPlace

    @property
    def kind(self) -> tuple[str, ...]:
        """What all runs of a study share."""
        names = sorted(name for name in self.run.parameters if name in _OF_THE_CAMERA)
        camera = self.details["camera_type"] or "camera type not known"
        return self.run.kind, camera, f"model {self.run.model}", ", ".join(names)


_FACTORS: Mapping[str, Callable[[_Run], str]] = {
    "operator": lambda recorded: recorded.run.operator or "",
    "bench": lambda recorded: f"{recorded.place.bench} {recorded.run.station}".strip(),
    "day": lambda recorded: recorded.run.begun_utc[:10],
}


@dataclass(frozen=True)
class _Studied:
    """A parameter with its study and, if its runs state limits, its capability."""

    name: str
    study: GaugeStudy
    capability: Capability | None


def show_capability(merged: MergedRuns, words: str) -> int:
    """Print the gauge study; exit status 1 if ledgers and folders do not agree."""
    factors = _factors(words)
    chosen = [
        _Run(run, more, merged.places[run.folder])
        for run, more in RunIndex(home_folder()).details(merged.runs)
        if run.how == "finished" and run.parameters
    ]
    _require_one_kind(chosen)
    levels = {name: [_FACTORS[name](recorded) for recorded in chosen] for name in factors}
    if "" in levels.get("operator", ()):
        raise UsageError(
            f"{levels['operator'].count('')} of {len(chosen)} runs name no operator.",
            remedy="Leave them out with --since, or study another factor: --factors day.",
        )
    cameras = [recorded.run.camera for recorded in chosen]
    studies = [
        _studied(name, chosen, cameras, levels) for name in chosen[0].run.parameters if name in _OF_THE_CAMERA
    ]
    show(
        lambda: _as_json(chosen, cameras, levels, studies),
        _lines(chosen, cameras, levels, studies),
    )
    return print_findings(merged.faults, merged.notes)


def _factors(words: str) -> list[str]:
    names = [word.strip() for word in words.split(",")]
    if wrong := [name for name in names if name not in _FACTORS]:
        raise UsageError(
            f"There is no factor {wrong[0]!r}.",
            where="--factors",
            remedy=f"There are: {', '.join(_FACTORS)}; several with commas.",
        )
    return list(dict.fromkeys(names))


def _require_one_kind(chosen: Sequence[_Run]) -> None:
    kinds = sorted({recorded.kind for recorded in chosen})
    if not kinds:
        raise UsageError(
            "There is no finished run with a result.",
            remedy="Name a FOLDER with runs, or a ledger with --ledger.",
        )
    if len(kinds) > 1:
        kinds_text = " and ".join(" / ".join(kind) for kind in kinds[:2])
        raise UsageError(
            f"The runs are of {len(kinds)} kinds, which a study never mixes: {kinds_text}.",
            remedy="Choose runs of one kind with --since, --until, --sequence or a FOLDER.",
        )


def _studied(
    name: str, chosen: Sequence[_Run], cameras: Sequence[str], levels: Mapping[str, Sequence[str]]
) -> _Studied:
    values = [recorded.run.parameters[name].value for recorded in chosen]
    gauge_study = study(values, cameras, levels)
    lower, upper = chosen[-1].details["limits"].get(name, (None, None))
    return _Studied(
        name, gauge_study, capability(lower, upper, fmean(values), gauge_study.total, gauge_study.gauge)
    )


def _as_json(
    chosen: Sequence[_Run],
    cameras: Sequence[str],
    levels: Mapping[str, Sequence[str]],
    studies: Sequence[_Studied],
) -> dict[str, Any]:
    return {
        "schema": "starbench/capability/1",
        "runs": [recorded.run.folder for recorded in chosen],
        "cameras": sorted(set(cameras)),
        "factors": {name: sorted(set(of_runs)) for name, of_runs in levels.items()},
        "parameters": [_parameter_json(studied) for studied in studies],
    }


def _parameter_json(studied: _Studied) -> dict[str, Any]:
    made = studied.study
    return {
        "name": studied.name,
        "unit": unit_text(studied.name),
        "analysis": [{"term": term.name, **_parts(term, _OF_TERM)} for term in made.terms],
        "pooled": list(made.pooled),
        "components": dict(made.components),
        **_parts(made, _OF_STUDY),
        **_parts(studied.capability, _OF_CAPABILITY),
    }


def _parts(of: object, names: Sequence[str]) -> dict[str, Any]:
    """Return some attributes of an object by name; of None, None each."""
    return {name: of and getattr(of, name) for name in names}


def _lines(
    chosen: Sequence[_Run],
    cameras: Sequence[str],
    levels: Mapping[str, Sequence[str]],
    studies: Sequence[_Studied],
) -> Iterator[str]:
    counts = [f"{len(set(of_runs))} {plural(name)}" for name, of_runs in levels.items()]
    head = ", ".join([counted(len(chosen), "run"), f"{len(set(cameras))} {plural(PART)}", *counts])
    yield f"{head}; standard deviations:"
    yield _row(_HEADS)
    for studied in studies:
        yield f"{_row(_cells(studied))}  {studied.study.verdict}"
    yield "EV repeatability, AV reproducibility, GRR both, PV cameras, TV total; %GRR = GRR / TV; ndc categories."
    yield "%GRR below 10 is good, to 30 conditional, above it not good; ndc should be 5 or more (AIAG MSA)."
    if any(studied.capability for studied in studies):
        yield "%tol = 6 GRR over the tolerance; Cp and Cpk by TV and the limits of the newest run."
    for studied in studies:
        seen = [
            f"{name} {number(value, 2)}"
            for name, value in studied.study.components.items()
            if name not in (PART, REPEATABILITY) and value > 0
        ]
        if seen:
            yield f"  {studied.name}, parts of AV: {', '.join(seen)}"


def _cells(studied: _Studied) -> tuple[str, ...]:
    made, fits = studied.study, studied.capability
    sizes = (made.repeatability, made.reproducibility, made.gauge, made.components[PART], made.total)
    share = f"{made.gauge_percent:.1f}"
    judged = (fits.tolerance_percent, fits.cp, fits.cpk) if fits else (None, None, None)
    categories = "-" if made.categories is None else str(made.categories)
    ratios = (
        "-" if value is None else f"{value:.{digits}f}"
        for value, digits in zip(judged, (1, 2, 2), strict=True)
    )
    return (
        studied.name,
        unit_text(studied.name),
        *(number(size, 2) for size in sizes),
        share,
        categories,
        *ratios,
    )


def _row(cells: Sequence[str]) -> str:
    return f"{cells[0]:<4}{cells[1]:<5}" + "".join(f"{cell:>9}" for cell in cells[2:])
