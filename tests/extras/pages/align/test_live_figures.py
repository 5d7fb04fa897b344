"""Live figures of recorded slices: good ones, and every kind of bad one with the rows that are not as expected."""

import dataclasses
import functools
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.extras.pages.align.figure_rows import figure_rows
from bench.extras.pages.align.live_figures import LiveFigures, LiveMeter, LiveSetting, LiveSlice
from bench.extras.pages.align.live_image import SignalFigures
from bench.stations.station import load_station
from drivers.camera import RecordingFacts
from simulators.pixels.biases import PixelSettings
from simulators.world.world import LightState
from tests.support import live_slices
from tests.support.live_slices import HEADER, bench, drive, seen, write_slice

REAL = Path(__file__).parents[3] / "data" / "evk4_real" / "imx636_1280x720_two_triggers.raw"
SETTING = LiveSetting.of_station(load_station("simulated").value, frequency_hz=60.0, light_on=True)
FRAMES = LiveSetting.of_station(load_station("simulated_frames").value, light_on=True)
FACTS = RecordingFacts("00050423", "EVK4", 1280, 720, 1000, 0.03, 10, 2, {}, {}, temperature_c=41.5)


def figures_of(path, setting=SETTING, **part):
    jpeg, figures = LiveMeter().measure(LiveSlice(path, **part), setting)
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image.shape == (figures.height_px, figures.width_px)
    json.dumps(figures.to_json(), allow_nan=False)
    return image, figures


def off(figures, setting=SETTING):
    """The rows that are not as expected."""
    rows = figure_rows(figures, setting)
    json.dumps(rows, allow_nan=False)
    return {row.name: row.value for row in rows if row.good is False}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("slices")


@pytest.fixture(scope="module")
def good(folder):
    """A sharp, rolled slice with the tag in the middle, of three whole periods."""
    return write_slice(folder / "good.raw", seen(bench(), pan=0.31, tilt=-0.2), periods=3)


def test_a_good_slice_shows_everything_and_needs_nothing(good):
    image, f = figures_of(good, facts=FACTS, reading_deg={"pan": 0.31, "tilt": -0.2}, time_s=5.0)
    assert off(f) == {}
    assert f.signal.trigger_hz == pytest.approx(60.0, rel=1e-4)
    assert f.signal.jitter_us < 1.0
    assert 60e6 < f.signal.events_per_s < 120e6
    assert 0.3 < f.signal.on_share < 0.6
    assert len(f.stars) > 230
    assert np.abs(np.mean(f.tag_corners_px, axis=0) - [639.5, 359.5]).max() < 8.0
    assert f.contrast > 0.9
    assert f.edge_width_px == pytest.approx(0.68, abs=0.1)
    assert np.ptp(image) > 200
    plain = f.to_json()
    assert len(plain["tag_corners_px"]) == 4
    assert plain["stars"][0][0] >= 0
    assert plain["time_s"] == 5.0


@pytest.mark.parametrize(
    ("content", "fault"),
    [(b"", "it is empty"), (HEADER + np.full(50, 0xC152, "<u2").tobytes(), "0xC152"), (None, "no such file")],
)
def test_files_that_hold_nothing(tmp_path, content, fault):
    path = tmp_path / "slice.raw"
    if content is not None:
        path.write_bytes(content)
    image, figures = figures_of(path)
    assert fault in off(figures)["Picture"]
    assert (image == 0).all()
    assert figures.edge_width_px is None


def test_darkness_is_the_light_that_is_off(tmp_path):
    path = write_slice(tmp_path / "dark.raw", seen(bench()), light=LightState(), triggers=False)
    setting = dataclasses.replace(SETTING, light_on=False, frequency_hz=None)
    _, figures = figures_of(path, setting)
    assert off(figures, setting) == {"Picture": "dark"}
    assert figures.stars == ()


def test_a_lens_cap(tmp_path):
    _, figures = figures_of(write_slice(tmp_path / "cap.raw", np.zeros((720, 1280), np.float32)))
    assert figures.signal.trigger_hz == pytest.approx(60.0, rel=1e-3)
    assert off(figures)["Frame in the beam"] == "0"
    assert "Sync edges" not in off(figures)


@pytest.mark.parametrize("light_on", [True, None])
def test_a_real_recording_without_a_flicker(light_on):
    setting = dataclasses.replace(SETTING, light_on=light_on, frequency_hz=None)
    image, figures = figures_of(REAL, setting)
    assert figures.signal.events_per_s == pytest.approx(65_900, rel=0.01)
    assert figures.signal.trigger_hz is None
    assert off(figures, setting)["Sync edges"]
    assert figures.stars == ()
    assert image.any()


def test_missing_sync_and_a_wrong_frequency(folder, tmp_path):
    share = seen(bench())
    _, without = figures_of(write_slice(tmp_path / "no_sync.raw", share, triggers=False, periods=2))
    turns = {name: value for name, value in off(without).items() if "Turn" in name}
    assert off(without) == {"Sync edges": "none"} | turns
    assert len(without.stars) > 200
    _, other = figures_of(write_slice(tmp_path / "fast.raw", share, light=drive(frequency_hz=75.0)))
    assert "74.999 Hz" in off(other)["Sync edges"]
    assert "60.000 Hz" in off(other)["Sync edges"]
    assert len(other.stars) > 200


def test_far_out_of_focus(tmp_path):
    reading = {"pan": 4.0}
    nothing = write_slice(tmp_path / "nothing.raw", seen(bench(circle_px=30.0), **reading))
    _, white = figures_of(nothing, reading_deg=reading)
    out_of_focus = {"Stars": "0", "Tag 3": "not found", "Edge width": "", "Turn pan by": "-4"}
    assert out_of_focus.items() <= off(white).items()
    truth = bench(circle_px=20.0)
    _, bright = figures_of(write_slice(tmp_path / "bright.raw", seen(truth, **reading)), reading_deg=reading)
    assert bright.to_json()["square"]["side_px"] > 100.0
    assert bright.turn.pan == pytest.approx(-4.0, abs=0.4)
    dim = write_slice(tmp_path / "dim.raw", seen(truth, pan=4.0), light=drive(10.0))
    _, figures = figures_of(dim, reading_deg={"pan": 4.0})
    assert figures.edge_width_px == pytest.approx(5.0, abs=0.7)
    assert off(figures)["Edge width"].startswith(("4.", "5."))


def test_light_of_the_room_and_high_thresholds_show(tmp_path, monkeypatch):
    settings = PixelSettings.from_biases({"bias_diff_on": 60, "bias_diff_off": 60}, room=0.6)
    monkeypatch.setattr(live_slices, "Sensor", functools.partial(live_slices.Sensor, settings=settings))
    _, figures = figures_of(write_slice(tmp_path / "room.raw", seen(bench(), pan=0.31, tilt=-0.2), periods=3))
    assert list(off(figures)) == ["Events an edge"]


def test_while_the_stage_turns_nothing_that_is_seen_is_judged(good):
    _, figures = figures_of(good, moving=True, facts=dataclasses.replace(FACTS, complete=False))
    assert list(off(figures)) == ["Picture"]
    assert (figures.stars, figures.turn.of) == ((), "")


def test_stars_without_a_tag_and_a_part_of_the_beam(tmp_path):
    reading = {"pan": 15.0, "tilt": 2.0}
    path = write_slice(tmp_path / "aside.raw", seen(bench(), **reading))
    _, figures = figures_of(path, reading_deg=reading)
    assert figures.beam_share < 0.5
    assert figures.tag_corners_px is None
    assert all(star[0] == -1 for star in figures.stars)
    assert (figures.turn.of, figures.turn.pan, figures.turn.tilt) == ("beam", -15.0, -2.0)
    assert {"Tag 3": "not found", "Turn pan by": "-15", "Turn tilt by": "-2"}.items() <= off(figures).items()


def test_a_tag_that_cannot_be_read_is_no_tag_out_of_view(tmp_path):
    truth = bench(circle_px=15.0, roll_deg=0.0)
    reading = {"pan": 5.5, "tilt": -4.5}
    path = write_slice(tmp_path / "cut.raw", seen(truth, **reading))
    _, figures = figures_of(path, reading_deg=reading)
    assert (figures.tag_corners_px, figures.turn.of) == (None, "square")
    assert figures.turn.pan == pytest.approx(-5.5, abs=0.5)
    assert figures.turn.tilt == pytest.approx(4.5, abs=0.5)


def test_a_short_arc_without_expected_values_gives_no_angle(tmp_path):
    v, u = np.indices((720, 1280))
    lit = 0.9 * (np.hypot(u - 3300.0, v - 359.5) < 2900.0).astype(np.float32)
    unknown = dataclasses.replace(SETTING, focal_px=None, half_angle_deg=None)
    _, figures = figures_of(write_slice(tmp_path / "arc.raw", lit), unknown)
    assert figures.disc_centre_px is None
    assert figures.turn.of == ""
    assert figures.turn.pan is None
    assert "Turn pan by" not in off(figures, unknown)


def test_stars_along_the_pixels_are_not_as_expected(tmp_path):
    path = write_slice(tmp_path / "level.raw", seen(bench(roll_deg=0.5), pan=0.31, tilt=-0.2))
    _, figures = figures_of(path)
    assert list(off(figures)) == ["Roll to the pixels"]


def test_rates_beyond_the_gates(good, tmp_path):
    low = dataclasses.replace(SETTING, gates=dataclasses.replace(SETTING.gates, max_event_rate_mev_s=50.0))
    _, figures = figures_of(good, low)
    assert list(off(figures, low)) == ["Event rate"]
    dropping = dataclasses.replace(FACTS, rate_controller_in=100, rate_controller_out=80)
    _, figures = figures_of(good, facts=dropping)
    assert off(figures) == {"Dropped events": "20.0"}
    assert figures.saturation == pytest.approx(0.2)
    lost = dataclasses.replace(FACTS, gaps=("3 ms are missing",), filters={"erc": True}, complete=False)
    _, figures = figures_of(good, facts=lost)
    assert off(figures) == {"Picture": "ended too early; data lost (3 ms are missing); filter ERC is on"}


def picture_file(path, image):
    cv2.imwrite(str(path), image)
    return path


def test_pictures_of_a_frame_camera(tmp_path):
    share = seen(bench(), pan=0.31, tilt=-0.2)
    grey = np.clip(170.0 * share + np.random.default_rng(1).normal(0.0, 2.0, share.shape), 0, 255)
    _, sharp = figures_of(picture_file(tmp_path / "sharp.tif", grey.astype(np.uint8)), FRAMES)
    assert off(sharp, FRAMES) == {}
    assert len(sharp.stars) > 230
    assert sharp.signal.events_per_s is None
    _, dark = figures_of(picture_file(tmp_path / "dark.tif", np.zeros((720, 1280), np.uint8)), FRAMES)
    assert off(dark, FRAMES)["Frame in the beam"] == "0"
    _, white = figures_of(picture_file(tmp_path / "white.tif", np.full((720, 1280), 255, np.uint8)), FRAMES)
    assert off(white, FRAMES)["Saturated"] == "100.0"
    bright = np.clip(500 * share, 0, 255).astype(np.uint8)
    _, saturated = figures_of(picture_file(tmp_path / "bright.tif", bright), FRAMES)
    assert "Saturated" in off(saturated, FRAMES)
    _, small = figures_of(picture_file(tmp_path / "small.tif", np.zeros((3, 5), np.uint8)), FRAMES)
    assert (small.width_px, small.height_px) == (5, 3)
    flat = np.full((720, 1280), 90, np.uint8)
    _, blurred = figures_of(picture_file(tmp_path / "flat.tif", flat), FRAMES)
    assert {"Stars", "Tag 3", "Contrast", "Edge width"} <= off(blurred, FRAMES).keys()


def test_what_is_not_finite_is_none():
    signal = SignalFigures(jitter_us=float("nan"))
    plain = LiveFigures(signal=signal, edge_width_px=np.float32(1.5)).to_json()
    assert plain["signal"]["jitter_us"] is None
    assert type(plain["edge_width_px"]) is float
