"""Rows of figures with what is expected beside them, and verdicts that stand while nobody touches anything."""

import pytest

from bench.extras.pages.align.figure_rows import FigureRow, SteadyVerdicts, figure_rows
from bench.extras.pages.align.live_figures import LiveFigures
from bench.extras.pages.align.live_image import LiveSetting, SignalFigures
from bench.extras.pages.align.where_to_turn import SteadyTurn, TurnFigures
from bench.stations.station import load_station

SETTING = LiveSetting.of_station(load_station("simulated").value, frequency_hz=60.0, light_on=True)


def rows_of(setting=SETTING, best_px=None, **figures):
    return {row.name: row for row in figure_rows(LiveFigures(**figures), setting, best_px)}


def test_the_focus_is_one_number_with_the_best_and_the_way_from_it():
    rows = rows_of(best_px=0.71, edge_width_px=1.42)
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


def test_a_frame_camera_has_no_rows_of_events():
    frames = LiveSetting.of_station(load_station("simulated_frames").value, light_on=True)
    assert {"Event rate", "Sync edges", "ON share"}.isdisjoint(rows_of(frames))
    assert rows_of(frames, saturation=0.5)["Saturated"].good is False


def test_a_verdict_stands_at_its_limit_and_changes_when_some_pictures_in_a_row_disagree():
    verdicts, row = SteadyVerdicts(), FigureRow("Contrast", "40", "%", "at least 30", good=True)

    def shown(*goods):
        return [verdicts.steady([row._replace(good=good)])[0].good for good in goods]

    assert shown(True, False, False) == [True, True, False]  # of the first pictures, most
    shown(*12 * (True,))
    assert set(shown(*40 * (*14 * (False,), True))) == {True}
    assert shown(*15 * (False,)) == [*14 * (True,), False]
    assert shown(*15 * (None,))[-1] is None


def test_noise_and_a_blurred_tag_change_no_turn():
    steady = SteadyTurn()
    for number in range(60):
        tag = TurnFigures(of="tag", pan=3.0 + 0.2 * (-1) ** number, tilt=-1.0, roll_deg=8.0)
        seen = TurnFigures(of="square", pan=5.0, tilt=2.0) if number % 8 else tag
        shown = steady.steady(seen, {"pan": 1.0})
        assert (shown.of, shown.tilt, shown.roll_deg) == ("tag", -1.0, 8.0)
        assert shown.pan == pytest.approx(3.0, abs=0.21)


@pytest.mark.parametrize(("reading_deg", "pan"), [({"pan": 1.01}, 3.0), ({"pan": 1.1}, 2.9)])
def test_a_motion_changes_the_turn_at_once(reading_deg, pan):
    steady, first = SteadyTurn(), TurnFigures(of="tag", pan=3.0, tilt=0.0)
    for _ in range(3):
        assert steady.steady(first, {"pan": 1.0}) == first
    assert steady.steady(TurnFigures(of="tag", pan=2.9, tilt=0.0), reading_deg).pan == pan
