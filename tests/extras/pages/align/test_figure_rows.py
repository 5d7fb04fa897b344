"""Rows of figures with what is expected beside them, and verdicts that stand while nobody touches anything."""

import dataclasses

import numpy as np
import pytest

from bench.extras.pages.align.figure_rows import FigureRow, SteadyVerdicts, figure_rows
from bench.extras.pages.align.focus import FocusFigures
from bench.extras.pages.align.live_figures import LiveFigures
from bench.extras.pages.align.live_image import LiveSetting, SignalFigures
from bench.extras.pages.align.steady_turn import SteadyTurn
from bench.extras.pages.align.where_to_turn import TurnFigures
from bench.stations.station import load_station

SETTING = LiveSetting.of_station(
    load_station("simulated").value, frequency_hz=60.0, light_on=True, homed=True
)


def rows_of(setting=SETTING, best_px=None, **figures):
    return {row.name: row for row in figure_rows(LiveFigures(**figures), setting, best_px)}


def test_the_focus_is_one_number_with_the_best_and_the_way_from_it():
    rows = rows_of(best_px=0.71, focus=FocusFigures(edge_width_px=1.42))
    assert [(row.value, row.unit) for row in rows.values() if row.group == "focus"] == [
        ("1.42", "px"),
        ("0.71", "px"),
        ("0.71", "px"),
    ]
    assert (rows["Edge width"].expected, rows["Edge width"].good) == ("at most 1", False)


@pytest.mark.parametrize(
    ("share", "good"), [(0.2, False), (0.25, True), (0.75, True), (0.8, False), (None, None)]
)
def test_a_number_is_judged_by_the_range_that_stands_beside_it(share, good):
    row = rows_of(signal=SignalFigures(on_share=share))["ON share"]
    assert (row.expected, row.good) == ("25 to 75", good)


def test_the_frequency_by_events_counts_where_no_sync_edges_do():
    assert rows_of(signal=SignalFigures(event_hz=70.0))["Flicker by events"].good is False
    both = rows_of(signal=SignalFigures(event_hz=70.0, trigger_hz=60.01))
    assert (both["Flicker by events"].good, both["Flicker by triggers"].good) == (None, True)


def test_a_frame_camera_has_no_rows_of_events():
    frames = LiveSetting.of_station(load_station("simulated_frames").value, light_on=True)
    assert {"Event rate", "Sync edges", "Hot pixels"}.isdisjoint(rows_of(frames))
    assert rows_of(frames, saturation=0.5)["Saturated"].good is False


def test_a_single_picture_over_a_limit_changes_no_verdict():
    verdicts, row = SteadyVerdicts(), FigureRow("Contrast", "40", "%", "at least 30", good=True)
    shown = [
        verdicts.steady([row._replace(good=good)])[0].good
        for good in (True, False, True, False, False, False)
    ]
    assert shown == [True, True, True, True, True, False]
    assert verdicts.steady([row._replace(good=None)])[0].good is None
    assert verdicts.steady([row])[0].good


VIEW = np.random.default_rng(1).random((90, 160)).astype(np.float32)


@pytest.mark.parametrize(
    ("change", "reading_deg", "kept"),
    [
        ({"pan": 3.15}, {"pan": 1.0}, True),
        ({"pan": 3.25}, {"pan": 1.0}, False),
        ({"pan": 3.05}, {"pan": 1.1}, False),
        ({"pan": 3.05}, {}, True),
        ({"of": "square", "pan": 4.0}, {"pan": 1.0}, True),
        ({"roll_deg": 9.0}, {"pan": 1.0}, True),
        ({"roll_deg": 10.0}, {"pan": 1.0}, False),
    ],
)
def test_noise_and_a_blurred_tag_change_no_turn_but_a_motion_does(change, reading_deg, kept):
    first = TurnFigures(of="tag", pan=3.0, tilt=-1.0, roll_deg=8.0, roll_by_deg=0.0)
    then = dataclasses.replace(first, **change)
    steady = SteadyTurn()
    assert steady.steady(first, VIEW, {"pan": 1.0}) == first
    assert steady.steady(then, VIEW, reading_deg) == (first if kept else then)


def test_a_better_sight_and_another_view_change_the_turn():
    square, tag = (TurnFigures(of=of, pan=3.0, tilt=0.0) for of in ("square", "tag"))
    steady = SteadyTurn()
    assert steady.steady(square, VIEW, {}) == square
    assert steady.steady(tag, VIEW, {}) == tag
    assert steady.steady(square, VIEW[::-1].copy(), {}) == square
