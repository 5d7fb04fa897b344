"""What a person did is named from what the station expects, and from what the last run of this bench had."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from bench.record.history import History
from bench.solve.causes import causes_of_run
from bench.wording import causes as kinds
from bench.wording.causes import sentence_of

LIGHT = {"waveform": "square", "frequency_hz": 60.0, "duty_percent": 50.0, "low_v": 0.0, "high_v": 5.0}


def causes(
    *, focal_px: float = 3345.0, last: dict[str, Any] | None = None, longest_s: float = 0.0, **seen: Any
):
    """Causes of a run with fx 3345 px, 600 stars a pose, 0.04 px of residuals and 1.2 events an edge."""
    now = {"stars": 600, "rms_px": 0.04, "events": 1.2, "light": LIGHT, **seen}
    names = ("left", "right")
    history = History()
    history.lateness = {"longest_s": longest_s}
    accepted = {
        k: SimpleNamespace(
            pose_name=name,
            measured={"image": {"events_per_edge": now["events"]}},
            stored={"light": now["light"]},
        )
        for k, name in enumerate(names)
    }
    history.accepted = lambda: accepted  # type: ignore[method-assign]
    calibration = SimpleNamespace(
        causes=(),
        camera=SimpleNamespace(fx=3345.0, fy=3345.0),
        U={"fx": 2.0, "fy": 2.0},
        rms_px=now["rms_px"],
        views=[SimpleNamespace(name=name, n=now["stars"]) for name in names],
    )
    job = SimpleNamespace(station=SimpleNamespace(expected=SimpleNamespace(focal_px=focal_px)))
    return causes_of_run(cast("Any", job), history, cast("Any", calibration), lambda: last or earlier())


def earlier(**changed: Any) -> dict[str, Any]:
    """Results of the last run: as this one, or changed."""
    then = {"stars": 600, "rms_px": 0.04, "events": 1.2, "light": LIGHT, **changed}
    poses = [
        {"name": name, "stars": then["stars"], "image": {"events_per_edge": then["events"]}}
        for name in ("left", "right")
    ]
    return {
        "run": {"id": "run-7"},
        "poses": poses,
        "conditions": {"light": then["light"]},
        "calibration": {"rms_px": then["rms_px"]},
    }


def test_a_run_as_the_last_one_has_no_cause():
    assert causes(stars=585, rms_px=0.043, events=1.1, longest_s=0.8, focal_px=3200.0) == []


@pytest.mark.parametrize(
    ("case", "kind", "words"),
    [
        ({"focal_px": 10300.0}, kinds.LENS, "The focal length is 3345 px, and the station expects 10300 px"),
        ({"stars": 379, "rms_px": 0.154}, kinds.FEWER, "379 stars a pose instead of 600 as in run run-7"),
        ({"rms_px": 0.154}, kinds.NOISIER, "the stars scatter by 0.15 px instead of 0.04"),
        ({"events": 0.6}, kinds.DIMMER, "0.6 events an edge instead of 1.2"),
        (
            {"light": {**LIGHT, "duty_percent": 15.0}},
            kinds.LIGHT,
            "duty was set to 15 %, and to 50 % in run run-7",
        ),
        ({"light": {**LIGHT, "high_v": 2.0}}, kinds.LIGHT, "level was set to 2 V, and to 5 V"),
        ({"longest_s": 60.0}, kinds.ASLEEP, "This computer stood still for 60 s"),
    ],
)
def test_each_is_told_with_both_numbers(case, kind, words):
    (found,) = causes(**case)
    assert found.kind == kind
    assert words in sentence_of(found)


def test_the_most_probable_cause_is_first():
    found = causes(focal_px=10300.0, stars=500)
    assert [one.kind for one in found] == [kinds.LENS, kinds.FEWER]
