"""The rehearsed world: the same stars for the same seed, pose and moment; a lens that follows the camera's temperature."""

import numpy as np
import pytest

from simulators.errors import ConfigError
from simulators.optics.picture import pose_rotation, star_centres, true_rotation
from simulators.rehearsed_world import RehearsedWorld

POSE = {"pan": 3.0, "tilt": -1.5}


def world(seed=1, **night):
    """Return a world without mounting rotation, so that seeds differ by their noise alone."""
    return RehearsedWorld({"rehearsal": night, "optics": {"mounting_deg": [0, 0, 0]}}, seed)


def test_the_same_seed_pose_moment_and_number_give_the_same_stars_and_any_other_does_not():
    first = world().record(POSE, 100.0, 0)
    again = world().record(POSE, 100.0, 0)
    assert (first.ids == again.ids).all()
    assert (first.points_px == again.points_px).all()
    for other in (
        world(2).record(POSE, 100.0, 0),
        world().record({**POSE, "pan": 3.001}, 100.0, 0),
        world().record(POSE, 101.0, 0),
        world().record(POSE, 100.0, 1),
    ):
        shared = np.intersect1d(first.ids, other.ids)
        assert len(shared) > 100
        assert not np.isin(first.points_px, other.points_px).any()


def test_stars_scatter_about_their_true_places_with_the_configured_sigma():
    rehearsed = world(star_sigma_px=0.1)
    seen = rehearsed.record(POSE, 50.0, 0)
    truth = rehearsed.truth(50.0)
    ids, points = star_centres(truth, pose_rotation(POSE, truth.optics), clearance=1.0, border_px=6.0)
    assert (ids == seen.ids).all()
    assert np.std(seen.points_px - points) == pytest.approx(0.1, rel=0.15)


def test_the_camera_warms_up_and_follows_its_room():
    rehearsed = world(room_c=20.0, room_c_per_h=-1.0, self_heating_c=10.0, warm_up_min=10.0)
    assert rehearsed.temperature_c(0.0) == 20.0
    assert rehearsed.temperature_c(600.0) == pytest.approx(20.0 - 1 / 6 + 10 * (1 - np.exp(-1)), abs=0.005)
    assert rehearsed.temperature_c(36_000.0) == pytest.approx(20.0, abs=1e-6)
    assert world(self_heating_c=5.0, warm_up_min=0.0, room_c=20.0).temperature_c(0.0) == 25.0


def true_stars(rehearsed, angles):
    truth = rehearsed.truth(50.0)
    return star_centres(truth, true_rotation(angles, truth), clearance=1.0, border_px=6.0)[1]


def test_the_camera_points_where_the_errors_of_the_gimbal_lead_it():
    errors = {"scale": 2e-3, "wobble_deg": 0.02, "eccentricity_deg": 0.05, "nonorthogonality_deg": 0.2}
    config = {"rehearsal": {"star_sigma_px": 0}, "gimbal": errors | {"seed": 8}}
    rehearsed = RehearsedWorld(config, 1)
    np.testing.assert_array_equal(rehearsed.record(POSE, 50.0, 0).points_px, true_stars(rehearsed, POSE))
    perfect = RehearsedWorld({"rehearsal": {"star_sigma_px": 0}}, 1)
    seen, exact = rehearsed.record(POSE, 50.0, 0), perfect.record(POSE, 50.0, 0)
    _, here, other = np.intersect1d(seen.ids, exact.ids, return_indices=True)
    moved = np.abs(seen.points_px[here] - exact.points_px[other]).max()
    assert 0.3 < moved < 40.0


def test_with_backlash_the_side_from_which_an_axis_came_matters():
    gimbal = {"backlash_deg": {"pan": 0.04}}
    rehearsed = RehearsedWorld({"rehearsal": {"star_sigma_px": 0}, "gimbal": gimbal}, 1)
    from_below = rehearsed.record({"pan": 3.0}, 50.0, 0).points_px
    np.testing.assert_array_equal(from_below, true_stars(rehearsed, {"pan": 2.98}))
    again = rehearsed.record({"pan": 3.0}, 60.0, 1).points_px
    np.testing.assert_array_equal(again, from_below)  # it did not move
    rehearsed.record({"pan": 5.0}, 60.0, 2)
    from_above = rehearsed.record({"pan": 3.0}, 60.0, 3).points_px
    np.testing.assert_array_equal(from_above, true_stars(rehearsed, {"pan": 3.02}))


def test_mishaps_are_as_frequent_as_configured():
    rehearsed = world(covered_share=0.2, lost_share=0.1)
    mishaps = [rehearsed.record(POSE, float(n), n) for n in range(400)]
    assert sum(m.mishap == "covered" for m in mishaps) == pytest.approx(80, abs=30)
    assert sum(m.mishap == "lost" for m in mishaps) == pytest.approx(40, abs=22)
    assert {len(m.ids) for m in mishaps if m.mishap == "covered"} == {20}
    assert all(not len(m.ids) for m in mishaps if m.mishap == "lost")


@pytest.mark.parametrize(
    ("night", "where"),
    [
        ({"room": 1}, "rehearsal.room"),
        ({"room_c": "warm"}, "rehearsal.room_c"),
        ({"room_c": True}, "rehearsal.room_c"),
        ({"star_sigma_px": -0.1}, "rehearsal.star_sigma_px"),
        ({"room_c": float("nan")}, "rehearsal.room_c"),
        ({"covered_share": 0.7, "lost_share": 0.7}, "rehearsal.covered_share"),
    ],
)
def test_an_invalid_value_is_refused_by_its_key(night, where):
    with pytest.raises(ConfigError) as error:
        world(**night)
    assert error.value.where == where
