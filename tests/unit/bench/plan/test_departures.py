"""What a run departs from before it begins: settings, and gates that were loosened."""

import pytest
from quick_runs import THREE, write_sequence, write_station

from bench.plan.departures import departures
from bench.plan.job import Job


@pytest.fixture
def departures_with(tmp_path):
    sequence, station = (
        write_sequence(tmp_path / "sequence.yaml", THREE),
        write_station(tmp_path / "station.yaml"),
    )

    def with_settings(settings):
        job = Job.from_files(str(sequence), str(station), seed=1, operator=None, settings=settings)
        return departures(job, settings)

    return with_settings


def test_a_run_as_its_files_say_departs_from_nothing(departures_with):
    assert departures_with({}) == []


GATES = "sequence.defaults.record.gates"


@pytest.mark.parametrize(
    ("settings", "gate"),
    [
        ({f"{GATES}.max_motion_px": "9"}, "The gate max_motion_px was 9, looser than its default 0.05."),
        ({f"{GATES}.min_stars": "1"}, "The gate min_stars was 1, looser than its default 40."),
        (
            {f"{GATES}.max_triggers_missed": "99"},
            "The gate max_triggers_missed was 99, looser than its default 1.",
        ),
        (
            {f"{GATES}.max_event_rate_mev_s": "900"},
            "The gate max_event_rate_mev_s was 900, looser than its default 200.",
        ),
        ({f"{GATES}.require_triggers": "false"}, "The gate require_triggers was off."),
    ],
)
def test_a_looser_gate_and_the_setting_that_loosened_it_are_each_told_once(departures_with, settings, gate):
    ((path, text),) = settings.items()
    assert departures_with(settings) == [f"{path} was set to {text} for this run.", gate]


@pytest.mark.parametrize("settings", [{f"{GATES}.max_motion_px": "0.01"}, {f"{GATES}.min_stars": "100"}])
def test_a_stricter_gate_is_told_as_a_setting_only(departures_with, settings):
    (only,) = departures_with(settings)
    assert only.endswith("for this run.")
