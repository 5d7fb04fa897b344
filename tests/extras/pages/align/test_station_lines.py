"""Lines for the station file: what a run needs to have what was found."""

from bench.extras.pages.align.station_lines import station_lines
from bench.stations.station import load_station


def test_pose_settings_and_level_are_stated_as_the_station_file_has_them():
    station = load_station("simulated").value
    lines = station_lines(
        station, position_deg={"pan": 1.23456, "tilt": 0.0}, camera={"bias_fo": -5}, level_percent=50.0
    )
    low, high = station.axes["pan"].limits_deg
    assert lines == [
        "stage.axes.pan.zero_deg: -1.2346",
        f"stage.axes.pan.limits_deg: [{low - 1.2346:g}, {high - 1.2346:g}]",
        "camera.biases.bias_fo: -5",
        "light.high_v: 2.5",
    ]


def test_nothing_is_stated_that_stands_there_already_or_cannot_be():
    station = load_station("simulated").value
    assert station_lines(station, position_deg={"pan": 99.0}, camera={}, level_percent=100.0) == []
