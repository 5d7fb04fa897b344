"""Packages of plug-ins and optional libraries in the software that a run states."""

from importlib.metadata import version

import pytest

from bench.solve import software as software_module
from bench.solve.results_content import software
from bench.solve.software import files_software, plugins_missing, plugins_of_run, plugins_stated, run_software
from bench.stations.plugins import Plugin
from bench.stations.station import load_station

STARTED = {
    "software": {"starbench-turntable": "1.0"},
    "plugins": {"starbench-turntable": ["stage turntable"]},
}


@pytest.fixture
def station():
    return load_station("simulated").value


@pytest.fixture
def brought(monkeypatch, station):
    """Two packages: one brings stage and light of the station, the other a stage that it does not use."""

    def plugins(kind):
        other = Plugin("stage", "lift", "lift 3", type("Lift", (), {}), distribution="lift", version="3")
        used = Plugin(
            kind, "turn", "starbench-turn 1.2", type(getattr(station, kind)), "", "starbench-turn", "1.2"
        )
        return {"stage": (other, used), "light": (used,), "camera": ()}[kind]

    monkeypatch.setattr(software_module, "plugins", plugins)


def test_a_run_states_the_package_of_each_plugin_that_its_station_uses(brought, station):
    assert run_software(station) == software() | {"starbench-turn": "1.2"}
    assert plugins_of_run(station) == {"plugins": {"starbench-turn": ["stage turn", "light turn"]}}


def test_a_package_never_replaces_an_entry_of_starbench(brought, station, monkeypatch):
    monkeypatch.setattr(
        software_module,
        "used_plugins",
        lambda _: [Plugin("stage", "x", "program 6", None, distribution="program", version="6")],
    )
    assert run_software(station)["program"] == software()["program"]


def test_libraries_of_drivers_and_of_files_of_others_are_stated_where_they_are_used(station, monkeypatch):
    assert files_software([".raw", ".png"]) == software()
    installed, real = {"neuromorphic-drivers": "0.18.1", "aedat": "2.3", "rosbags": "0.11"}, version
    monkeypatch.setattr("importlib.metadata.version", lambda name: installed.get(name) or real(name))
    evk4 = station.model_copy(update={"camera": type("Camera", (), {"driver": "neuromorphic_evk4"})()})
    assert run_software(evk4)["neuromorphic-drivers"] == "0.18.1"
    assert files_software([".AEDAT4", ".raw"]) == software() | {"aedat": "2.3"}
    assert files_software([".mcap", ".bag"]) == software() | {"rosbags": "0.11"}


def test_a_plugin_that_is_missing_here_or_has_another_version_is_named(brought):
    assert plugins_stated(STARTED) == {"starbench-turntable 1.0": "stage turntable"}
    assert plugins_missing(STARTED) == ["starbench-turntable 1.0"]
    here = {"software": {"starbench-turn": "1.2"}, "plugins": {"starbench-turn": ["stage turn"]}}
    assert plugins_missing(here) == []
    here["software"]["starbench-turn"] = "1.3"
    assert plugins_missing(here) == ["starbench-turn 1.3"]
