"""Blinking dots with a frequency each, and a screen that is drawn line by line, as events of the camera."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lombscargle

from drivers.camera.evt3 import Evt3Decoder
from simulators.config import bench_config
from simulators.optics import scene
from simulators.optics.board_scene import images_of_lights
from simulators.pixels.sensor import Sensor
from simulators.pixels.sensor_stream import CameraState, ManyLightsSensor, SensorStream
from simulators.world.board import BoardState
from simulators.world.world import LightState, World

CAMERA = {"fx": 800, "fy": 800, "cx": 159.5, "cy": 119.5, "width": 320, "height": 240, "k1": 0, "k2": 0}
DOTS = {"kind": "blinking-dots", "columns": 4, "rows": 3, "pitch_mm": 30, "dot_mm": 9,
        "placements": [{"position_mm": [0, 0, 500], "turn_deg": [10, -15, 5]}]}  # fmt: skip
SCREEN = {"kind": "checkerboard", "columns": 5, "rows": 5, "pitch_mm": 20, "refresh_hz": 120, "scan": 0.8,
          "placements": [{"position_mm": [0, 0, 600]}]}  # fmt: skip


def truth_of(board, noise="none"):
    """Truth of a small camera in front of a board."""
    sections = {"camera": CAMERA, "board": board, "noise": noise, "optics": {"mounting_deg": [0, 0, 0]}}
    return bench_config(sections).truth_for(1)


def events_of(truth, frames=50, *, act=None):
    """Events of a recording, as the words say: t in s, x, y, p."""
    world = World(truth, clock=lambda: 100.0)
    world.set_light(LightState(output=True, sync=True))
    stream = SensorStream(world, CameraState(trigger_in=True), {})
    words = []
    for number in range(frames):
        if act is not None and number == frames // 2:
            act(world)
        words.append(stream.next_frame())
    decoded = [e for e, _ in Evt3Decoder(320, 240).decode(np.frombuffer(b"".join(words), "<u2"))]
    t, x, y, p = (np.concatenate([getattr(e, name) for e in decoded]) for name in "txyp")
    assert (np.diff(t) >= 0).all()
    return t * 1e-6, x.astype(int), y.astype(int), p.astype(bool)


def at_dots(truth, events, radius=7.0):
    """For each dot the times of ON events near it, and their mean place."""
    t, x, y, p = events
    for u, v in scene.corners(truth, {}):
        near = p & (np.hypot(x - u, y - v) < radius)
        yield t[near], (x[near].mean(), y[near].mean())


def frequency(t, around_hz):
    """Frequency of events, by Lomb's and Scargle's periodogram of their rate."""
    hz = np.arange(around_hz - 8, around_hz + 8, 0.2)
    edges = np.arange(t[0], t[-1], 2e-4)
    rate = np.histogram(t, edges)[0].astype(float)
    return hz[lombscargle(edges[:-1], rate - rate.mean(), 2 * np.pi * hz).argmax()]


def test_each_dot_blinks_with_its_own_frequency_where_the_truth_puts_it():
    truth = truth_of(DOTS)
    expected = np.linspace(200, 600, 12)
    found = list(at_dots(truth, events_of(truth)))
    assert len(found) == 12
    for (t, middle), hz, corner in zip(found, expected, scene.corners(truth, {}), strict=True):
        assert frequency(t, hz) == pytest.approx(hz, abs=1.0)
        assert np.abs(np.array(middle) - corner).max() < 0.15
        gaps = np.diff(t)
        assert np.count_nonzero(gaps > 0.4 / hz) == pytest.approx(
            0.1 * hz, abs=2
        )  # pauses between the flashes


def test_dots_of_one_frequency_keep_their_phases():
    phases = [0.0, 0.25, 0.5, 0.75]
    board = {**DOTS, "columns": 2, "rows": 2, "frequencies_hz": [300] * 4, "phases": phases}
    truth = truth_of(board)
    onsets = [
        np.angle(np.exp(2j * np.pi * 300 * t).mean()) / (2 * np.pi)
        for t, _ in at_dots(truth, events_of(truth))
    ]
    # A later phase is an earlier edge.
    assert np.abs((np.array(onsets) - onsets[0] + phases + 0.5) % 1.0 - 0.5).max() < 0.02


def test_the_pattern_of_the_cameras_pixels_holds_in_each_window():
    truth = truth_of(DOTS, "typical")
    seeds = np.random.SeedSequence(3)
    from simulators.pixels.biases import PixelSettings

    many = ManyLightsSensor(truth, {}, settings=PixelSettings(), camera_seed=7, seed=seeds)
    many.begin(scene.picture(truth, {}), LightState(output=True), 0.0)
    whole = Sensor(320, 240, noise=truth.noise, camera_seed=7).thresholds
    for light, sensor in many.parts:
        window = slice(light.top, light.top + sensor.height), slice(light.left, light.left + sensor.width)
        for own, all_pixels in zip(sensor.thresholds, whole, strict=True):
            np.testing.assert_array_equal(own, all_pixels[window])


def test_each_pixel_belongs_to_one_light_at_most():
    for board in (DOTS, {**DOTS, "dot_mm": 28}, SCREEN):
        truth = truth_of(board)
        owned = np.zeros((240, 320))
        for light in images_of_lights(truth, {}):
            rows, columns = light.share.shape
            owned[light.top : light.top + rows, light.left : light.left + columns] += light.share
        assert owned.max() == 1.0
        assert owned[scene.picture(truth, {}) > 0.01].min() == 1.0


def test_lines_of_a_screen_are_drawn_one_after_the_other():
    truth = truth_of(SCREEN)
    t, _, y, p = events_of(truth)
    rows = scene.corners(truth, {}).reshape(5, 5, 2)[:, 0, 1]
    phases = []
    for row in rows:
        near = p & (np.abs(y - row) < 3)
        phases.append(np.angle(np.exp(2j * np.pi * 60 * t[near]).mean()) / (2 * np.pi))
    late = np.diff(np.unwrap(phases, period=1.0)) / 60  # s a square
    np.testing.assert_allclose(late, 0.8 / 120 / 6, rtol=0.25)
    drawn_at_once = truth_of({**SCREEN, "scan": 0})
    t, _, y, p = events_of(drawn_at_once)
    first = [np.angle(np.exp(2j * np.pi * 60 * t[p & (np.abs(y - row) < 3)]).mean()) for row in rows]
    assert np.ptp(first) < 0.05


def test_dots_are_found_again_when_the_board_is_placed_anew():
    truth = truth_of({**DOTS, "placements": [*DOTS["placements"], {"position_mm": [30, 12, 600]}]})

    def place(world):
        world.change_setup(lambda setup: replace(setup, board=BoardState(2)))

    events = events_of(truth, act=place)
    late = events[0] > events[0][0] + 0.06
    after = tuple(column[late] for column in events)
    second = replace(truth, board=truth.board.in_state(BoardState(2)))
    for (t, middle), hz, corner in zip(
        at_dots(second, after), np.linspace(200, 600, 12), scene.corners(second, {}), strict=True
    ):
        assert frequency(t, hz) == pytest.approx(hz, abs=2.5)
        assert np.abs(np.array(middle) - corner).max() < 0.15


def test_a_shaking_hand_moves_the_dots():
    hand = {"shake_mm": 1.0, "shake_spectrum": [[9, 1], [10, 1]]}
    truth = truth_of({**DOTS, "hand": hand})
    t, x, y, _ = events_of(truth)
    u, v = scene.corners(truth, {})[5]
    near = np.hypot(x - u, y - v) < 11
    places = [x[near & (t > a) & (t < a + 0.01)].mean() for a in t[0] + np.arange(0, 0.09, 0.01)]
    assert 1.0 < np.ptp(places) < 12.0  # 1 mm is 1.6 px


@pytest.mark.parametrize("hand", [{}, {"shake_mm": 0.5}])
def test_a_live_picture_follows_the_dots(hand):
    truth = truth_of(
        {**DOTS, "placements": [*DOTS["placements"], {"position_mm": [30, 12, 600]}], "hand": hand}
    )
    now = [100.0]
    world = World(truth, clock=lambda: now[0])
    stream = SensorStream(world, CameraState(), {}, preview=True)
    for number in (1, 2):
        world.change_setup(lambda setup, number=number: replace(setup, board=BoardState(number)))
        now[0] += 1.0
        assert stream.go_on(CameraState(), stream.clock_us)
        words = np.frombuffer(b"".join(stream.next_frame() for _ in range(10)), "<u2")
        decoded = [e for e, _ in Evt3Decoder(320, 240).decode(words)]
        x, y = (np.concatenate([getattr(e, name) for e in decoded]) for name in "xy")
        corners = scene.corners(replace(truth, board=truth.board.in_state(BoardState(number))), {})
        assert all(np.count_nonzero(np.hypot(x - u, y - v) < 7) > 100 for u, v in corners)
