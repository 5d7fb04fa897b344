"""What a run departs from before it begins: settings, and gates that were loosened."""

import pytest
from quick_runs import THREE, write_sequence, write_station

from bench.plan.departures import departures
from bench.plan.job import Job


@pytest.fixture
def departures_with(tmp_path):
    sequence = write_sequence(tmp_path / "sequence.yaml", THREE)
    station = write_station(tmp_path / "station.yaml")

    def with_settings(settings):
        job = Job.from_files(str(sequence), str(station), seed=1, operator=None, settings=settings)
        return departures(job, settings)

    return with_settings


GATES = "sequence.defaults.record.gates"


@pytest.mark.parametrize(
    ("gate", "looser", "default"),
    [
        ("max_motion_px", "9", "0.05"),
        ("min_stars", "1", "40"),
        ("max_triggers_missed", "99", "1"),
        ("max_event_rate_mev_s", "900", "200"),
        ("require_triggers", "false", "off"),
    ],
)
def test_a_looser_gate_and_the_setting_that_loosened_it_are_each_told_once(
    departures_with, gate, looser, default
):
    setting, loosened = departures_with({f"{GATES}.{gate}": looser})
    assert setting.startswith(f"{GATES}.{gate} was set to {looser}")
    assert gate in loosened
    assert loosened.endswith(f" {default}.")


@pytest.mark.parametrize("settings", [{f"{GATES}.max_motion_px": "0.01"}, {f"{GATES}.min_stars": "100"}, {}])
def test_a_stricter_gate_is_told_as_a_setting_only(departures_with, settings):
    told = departures_with(settings)
    assert [name for name in settings if told[0].startswith(name)] == list(settings)
    assert len(told) == len(settings)
