"""Placements of a board: by a script, at random, by a hand that scatters and shakes, and by orders."""

import math
from dataclasses import replace

import numpy as np
import pytest

from simulators.bench import Bench
from simulators.config import bench_config
from simulators.errors import ConfigError
from simulators.faults.catalogue import fault_order_from_text
from simulators.optics import scene
from simulators.optics.lens_focus import truth_record
from simulators.rehearsed_world import RehearsedWorld
from simulators.world.board import BoardState, HandShake, HandTruth, placement, pose

CHECKER = {"kind": "checkerboard", "columns": 8, "rows": 5, "pitch_mm": 20}
SCRIPT = [{"position_mm": [0, 0, 900]}, {"position_mm": [30, -10, 1000], "turn_deg": [20, 0, 180]}]


def truth_of(seed=1, **board):
    """Truth of a bench with a checkerboard."""
    return bench_config({"board": {**CHECKER, **board}}).truth_for(seed)


def placed(truth, number):
    """The truth with the board at a placement."""
    return replace(truth, board=truth.board.in_state(BoardState(number)))


def test_the_script_is_followed_and_begins_again():
    truth = truth_of(placements=SCRIPT)
    depths = [pose(placed(truth, n).board).middle_mm[2] for n in (1, 2, 3)]
    assert depths == [900.0, 1000.0, 900.0]
    upright, turned = (scene.corners(placed(truth, n), {}) for n in (1, 2))
    assert upright[0, 0] < upright[7, 0]
    assert turned[0, 0] > turned[7, 0]  # upside down


def test_the_same_number_gives_the_same_place_and_another_number_another():
    board = {"anywhere": {"tilt_deg": 30}, "hand": {"scatter_mm": 4, "scatter_deg": 2}}
    first, again, other = truth_of(**board), truth_of(**board), truth_of(2, **board)
    corners = [scene.corners(placed(t, n), {}) for t, n in ((first, 3), (again, 3), (first, 4), (other, 3))]
    np.testing.assert_array_equal(corners[0], corners[1])
    assert np.abs(corners[0] - corners[2]).max() > 5
    assert np.abs(corners[0] - corners[3]).max() > 5


def test_the_hand_scatters_as_stated():
    truth = truth_of(placements=SCRIPT[:1], hand={"scatter_mm": 4, "scatter_deg": 2})
    poses = [pose(placed(truth, n).board) for n in range(1, 400)]
    offsets = np.array([one.middle_mm for one in poses]) - [0, 0, 900]
    np.testing.assert_allclose(offsets.std(axis=0), 4.0, rtol=0.15)
    assert np.abs(offsets.mean(axis=0)).max() < 0.8
    tilts = [math.degrees(math.acos(one.rotation[2, 2])) for one in poses]
    assert np.sqrt(np.mean(np.square(tilts))) == pytest.approx(2.0 * math.sqrt(2.0), rel=0.1)


def test_random_places_show_the_whole_board_at_many_tilts():
    truth = truth_of(anywhere={"distance_mm": 1000, "tilt_deg": 40})
    middles, tilts = [], []
    for number in range(1, 60):
        corners = scene.corners(placed(truth, number), {})
        assert (corners > 10).all()
        assert (corners < [1270, 710]).all()
        middles.append(corners.mean(axis=0))
        tilts.append(math.degrees(math.acos(pose(placed(truth, number).board).rotation[2, 2])))
    assert np.ptp(middles, axis=0)[0] > 400
    assert max(tilts) > 30
    assert min(tilts) < 15


def test_shaking_has_the_stated_rms_and_spectrum():
    hand = HandTruth(shake_mm=0.2, shake_deg=0.1, shake_spectrum=((8.0, 1.0), (12.0, 1.0)))
    times = np.arange(0, 40.0, 0.02)
    power, square = 0.0, np.zeros(6)
    for seed in range(3):
        shake = HandShake(hand, np.random.default_rng(seed))
        moved = np.array([shake.at(t) for t in times])
        square += (moved**2).mean(axis=0) / 3
        power = power + np.abs(np.fft.rfft(moved.T / [[0.2]] * np.hanning(times.size))) ** 2
    np.testing.assert_allclose(np.sqrt(square), [0.2] * 3 + [0.1] * 3, rtol=0.05)
    hz, power = np.fft.rfftfreq(times.size, 0.02), power.sum(axis=0)
    assert power[(hz > 7.9) & (hz < 12.1)].sum() > 0.99 * power.sum()
    low, high = (power[(hz > a) & (hz < a + 2)].sum() for a in (8, 10))
    assert low == pytest.approx(high, rel=0.1)


def test_orders_of_a_person_move_the_board(tmp_path):
    config = bench_config({"board": {**CHECKER, "placements": SCRIPT}, "ports": "tcp"})
    bench = Bench(tmp_path, config)

    def do(text):
        bench.hands.action(fault_order_from_text(text))()
        return bench.world.truth_at(bench.world.now_s()).board

    assert do("board place number=2").state == BoardState(2)
    assert bench.hands.seen()["placement"] == 2
    assert truth_record(bench.world.truth_at(bench.world.now_s()))["board"]["placed"]["number"] == 2
    np.testing.assert_allclose(pose(do("board move x_mm=5 z_mm=-40")).middle_mm, [35, -10, 960])
    before = pose(bench.world.truth_at(bench.world.now_s()).board).rotation
    turned = pose(do("board turn z_deg=90")).rotation
    np.testing.assert_allclose(turned, np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ before, atol=1e-9)
    assert not do("board steady").state.flicker
    assert do("board second x_mm=200").state.second_mm == (200.0, 0.0, 0.0)
    assert do("board mend").state == BoardState(2)
    assert do("board next").state == BoardState(3)
    with pytest.raises(ConfigError, match="Count from 1"):
        do("board place number=0")
    with pytest.raises(ConfigError, match="no board"):
        Bench(tmp_path, bench_config({})).hands.action(fault_order_from_text("board next"))


def test_a_board_without_flicker_is_steady_and_its_sync_edges_go_on(tmp_path):
    from simulators.world.world import LightState

    sections = {"board": {**CHECKER, "placements": [{**SCRIPT[0], "flicker": False}, SCRIPT[1]]}}
    bench = Bench(tmp_path, bench_config(sections))
    bench.world.set_light(LightState(output=True, sync=True))
    light = bench.world.light(bench.world.now_s())
    assert light.low == light.high == 1.0
    assert light.sync
    bench.hands.action(fault_order_from_text("board place number=2"))()
    assert bench.world.light(bench.world.now_s()).low == 0.0


def test_a_screen_with_a_refresh_rate_has_its_own_clock(tmp_path):
    bench = Bench(tmp_path, bench_config({"board": {**CHECKER, "refresh_hz": 144, "frames_off": 2}}))
    light = bench.world.light(bench.world.now_s())  # the bench's light is off
    assert light.output
    assert not light.sync
    assert light.frequency_hz == pytest.approx(48.0)
    assert light.duty_percent == pytest.approx(100 / 3)


def test_a_star_target_is_placed_by_its_tag():
    truth = bench_config(
        {"board": {"kind": "stars", "placements": [{"position_mm": [10, 5, 700]}]}}
    ).truth_for(1)
    assert placement(truth.board).position_mm == (10.0, 5.0, 700.0)
    ids = truth.target.ids
    nearest = np.linalg.norm(truth.target.positions_mm(ids) - truth.target.tag_centre_mm, axis=1)
    corners = scene.corners(truth, {})[np.argsort(nearest)[:8]].mean(axis=0)
    assert np.abs(corners - [642.1 + 3345 * 10 / 700, 363.3 + 3345 * 5 / 700]).max() < 40


def test_a_random_placement_does_not_depend_on_the_cameras_temperature():
    truth = truth_of(anywhere={})
    warm = replace(truth, camera=replace(truth.camera, fx=truth.camera.fx * 1.001))
    for number in range(1, 30):
        one, other = (placement(placed(t, number).board) for t in (truth, warm))
        assert one == other


def test_a_rehearsal_refuses_a_board():
    with pytest.raises(ConfigError, match="star target") as error:
        RehearsedWorld({"board": CHECKER}, 1)
    assert error.value.where == "board"
