"""What a person did is named from what the station expects, and from what the last run of this bench had."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from bench.record.history import History
from bench.solve.causes import beside_last_run, causes_of_run
from bench.solve.results_content import causes_without_earlier_run
from bench.wording import causes as kinds
from bench.wording.causes import sentence_of
from calib.model import cause as of_views
from calib.model.cause import Cause

LIGHT = {"waveform": "square", "frequency_hz": 60.0, "duty_percent": 50.0, "low_v": 0.0, "high_v": 5.0}
SET = (("slewing", "2026-03-01T10:00:00+00:00", 100.0), ("settling", "2026-03-01T10:30:00+00:00", 101.0))
CAMERA = {"biases": {"bias_diff_off": 0, "bias_fo": 0}, "filters": {"trail": False}}


SEEN = {
    "stars": 600, "columns": 0, "rms_px": 0.04, "lit": 700_000, "off": 2.0, "delay_us": 9.0, "duty": 0.5, "light": LIGHT, **CAMERA,
}  # fmt: skip


def _image(run: dict[str, Any]) -> dict[str, Any]:
    return {
        "lit_pixels": run["lit"], "events_per_edge_off": run["off"], "first_on_delay_us": run["delay_us"],
        "silent_columns": run["columns"],
    }  # fmt: skip


def causes(
    *,
    focal_px: float | None = 3345.0,
    last: dict[str, Any] | None = None,
    first: bool = False,
    longest_s: float = 0.0,
    states: tuple[tuple[str, str, float], ...] = (),
    **seen: Any,
):
    """Causes of a run with fx 3345 px, 600 stars a pose, 0.04 px of residuals, 700 000 lit pixels with 2 OFF events an edge."""
    now = {**SEEN, **seen}
    names = ("left", "right")
    history = History()
    history.lateness = {"longest_s": longest_s}
    history.states = [{"state": state, "utc": utc, "mono_s": mono_s} for state, utc, mono_s in states]
    accepted = {
        k: SimpleNamespace(
            pose_name=name,
            measured={"image": _image(now), "flicker_duty": now["duty"]},
            stored={"light": now["light"], "facts": {name: now[name] for name in CAMERA}},
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
    expected = (
        None
        if focal_px is None
        else SimpleNamespace(
            focal_px=focal_px, star_sigma_px=0.03 if first else 0.2, collimator=SimpleNamespace(rms_px=0.0)
        )
    )
    job = SimpleNamespace(station=SimpleNamespace(expected=expected))
    run = cast("Any", job), history, cast("Any", calibration)
    return causes_of_run(*run) if first else beside_last_run(*run, last or earlier())


@pytest.fixture(autouse=True)
def stars_that_the_station_expects(monkeypatch):
    """Whatever the test says: none, unless it sets a number."""
    monkeypatch.setattr("bench.solve.causes.expected_stars", lambda *_: None)


def earlier(**changed: Any) -> dict[str, Any]:
    """Results of the last run: as this one, or changed."""
    then = {**SEEN, "fx": 3345.0, **changed}
    facts = {"stars": then["stars"], "image": _image(then), "flicker_duty": then["duty"]}
    poses = [{"name": name, **facts} for name in ("left", "right")]
    return {
        "run": {"id": "run-7"},
        "poses": poses,
        "conditions": {"light": then["light"], "camera": {name: then[name] for name in CAMERA}},
        "calibration": {"rms_px": then["rms_px"], "camera": {"fx": then["fx"], "fy": then["fx"]}},
    }


def test_a_run_as_the_last_one_has_no_cause():
    slightly = {"stars": 585, "rms_px": 0.043, "lit": 680_000, "off": 1.9, "delay_us": 10.0, "duty": 0.503}
    assert causes(**slightly, longest_s=0.8, focal_px=3200.0) == []


@pytest.mark.parametrize(
    ("case", "kind", "numbers"),
    [
        ({"focal_px": 10300.0}, kinds.LENS, "3345 px instead of 10300 px"),
        ({"stars": 379, "rms_px": 0.154}, kinds.FEWER, "379 stars a pose instead of 600 as in run run-7"),
        ({"rms_px": 0.154}, kinds.NOISIER, "0.15 px instead of 0.04"),
        ({"lit": 400_000, "delay_us": None}, kinds.DIMMER, "800000 events instead of 1400000"),
        # Neither later nor as early as before: both are told.
        ({"lit": 400_000, "delay_us": 11.0}, kinds.DIMMER, "dim lamp"),
        # As measured in simulations of a third of the lamp's light from the room.
        ({"lit": 616_000, "off": 1.03, "delay_us": 7.6}, kinds.ROOM, "bright room"),
        # As measured in simulations of a quarter of the light: the stars are as many, and as good.
        ({"lit": 600_000, "off": 1.62, "delay_us": 22.0}, kinds.SLOWER, "22 us after"),
        # Of half the light.
        ({"lit": 661_000, "off": 1.91, "delay_us": 14.0}, kinds.SLOWER, "14 us after it turns on, instead of 9"),
        ({"duty": 0.15}, kinds.LIGHT, "sync signal was 15 %, and 50 %"),
        ({"light": {**LIGHT, "duty_percent": 15.0}}, kinds.LIGHT, "duty was 15 %, and 50 %"),
        ({"light": {**LIGHT, "high_v": 2.0}}, kinds.LIGHT, "level was 2 V, and 5 V"),
        ({"biases": {"bias_diff_off": 60, "bias_fo": 0}, "lit": 400_000}, kinds.CAMERA, "bias_diff_off was 60, and 0"),
        ({"filters": {"trail": True}}, kinds.CAMERA, "trail was on, and off"),
        ({"longest_s": 60.0}, kinds.ASLEEP, "60 s"),
        # What one cause explains is not a cause of its own.
        ({"focal_px": 5100.0, "stars": 300, "lit": 300_000}, kinds.LENS, "5100 px"),
        ({"light": {**LIGHT, "high_v": 0.5}, "stars": 300, "lit": 300_000}, kinds.LIGHT, "0.5 V"),
    ],
)  # fmt: skip
def test_each_is_told_with_both_numbers(case, kind, numbers):
    (cause,) = causes(**case)
    assert cause.kind == kind
    assert numbers in sentence_of(cause)


def test_a_sine_has_no_delay_and_later_events_of_another_waveform_are_not_compared():
    sine = {**LIGHT, "waveform": "sine"}
    assert causes(light=sine, last=earlier(light=sine), delay_us=14.0) == []
    assert causes(light=sine, delay_us=14.0) == []


def test_stars_that_silent_columns_cost_are_no_sign_of_a_weak_image():
    assert [cause.kind for cause in causes(stars=400)] == [kinds.FEWER]
    assert causes(stars=400, columns=7) == []


def test_earlier_events_are_no_sign_of_a_weak_image():
    assert causes(delay_us=5.0) == []


def test_what_rests_on_the_last_run_has_its_name_and_stands_beside_what_the_run_shows_alone():
    changed = {"focal_px": 10300.0, "light": {**LIGHT, "high_v": 2.0}, "stars": 300}
    told, alone = causes(**changed), causes(**changed, first=True)
    assert [cause for cause in told if not cause.before] == alone
    assert [cause.kind for cause in told if cause.before] == [kinds.LIGHT]


def test_a_cause_between_two_poses_rests_on_no_earlier_run():
    knocked = Cause(of_views.TURNED, 50.0, 0.3, before="two", pose="three").to_dict()
    dimmed = Cause(kinds.DIMMER, 50.0, 4.0, stated=8.0, before="run-7").to_dict()
    assert causes_without_earlier_run(cast("Any", {"causes": [knocked, dimmed]})) == [knocked]


def test_a_station_that_expects_no_lens_has_that_of_the_last_run():
    assert causes(focal_px=None) == []
    (cause,) = causes(focal_px=None, last=earlier(fx=5000.0, stars=300))
    assert "3345 px instead of 5000 px" in sentence_of(cause)


@pytest.mark.parametrize(
    ("seen", "kind", "words"),
    [
        ({}, "", ""),
        ({"stars": 300}, kinds.FEWER, "300 stars a pose instead of 600 as the station expects"),
        ({"rms_px": 0.2}, kinds.NOISIER, "scatter by 0.14 px instead of 0.03 as the station expects"),
        ({"stars": 300, "rms_px": 0.2}, kinds.FEWER, "300 stars"),
    ],
)
def test_the_first_run_of_a_bench_has_what_its_station_expects(monkeypatch, seen, kind, words):
    monkeypatch.setattr("bench.solve.causes.expected_stars", lambda *_: 600.0)
    found_causes = causes(first=True, **seen)
    assert [cause.kind for cause in found_causes] == [kind] * bool(kind)
    assert all(words in sentence_of(cause) for cause in found_causes)


def test_a_computer_whose_time_of_day_was_set_did_not_stand_still():
    assert causes(states=SET) == []
