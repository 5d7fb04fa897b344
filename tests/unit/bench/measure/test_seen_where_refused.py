"""A picture that is refused is told by what it shows, on a large and on a small sensor: stars, dark parts, a mirror."""

import numpy as np
import pytest
from virtual_camera import QUARTER, VirtualCamera

from bench.measure.measure import EventData, find_stars, whole_image, why_no_target
from calib.errors import StarsUnnamed, TargetNotFound
from calib.target import StarTarget
from drivers.camera.event_arrays import Events, Triggers

SENSORS = {"720 rows": {}, "360 rows": QUARTER}
NO_EDGES = Triggers(np.empty(0, np.int64), np.empty(0, np.uint8), np.empty(0, np.uint8))
BEFORE, BESIDE = {"pan": -6.0, "tilt": 2.0}, {"pan": -14.5, "tilt": -2.0}


def half_covered(light):
    return light * (np.arange(light.shape[1]) >= 0.45 * light.shape[1])


def with_ghost(light):
    return light + 0.3 * light[::-1, ::-1]


def mirrored(light):
    return light[:, ::-1]


def refusal(sensor, angles_deg=BEFORE, change=None, **section):
    """Return why a recording of four flicker periods is refused."""
    camera = VirtualCamera({"camera": dict(SENSORS[sensor]), **section}, 1)
    seen = camera.picture
    camera.picture = lambda angles: np.ascontiguousarray((change or np.asarray)(seen(angles)), np.float32)
    taken = camera.capture(angles_deg, seed=3, light_hz=240.0, periods=4)
    facts = {}
    data = EventData(Events(*taken.events), NO_EDGES, taken.image_size, 0)
    image = whole_image(data, "auto", 4, 240.0, facts).image
    with pytest.raises(TargetNotFound) as refused:
        find_stars(image, StarTarget(), "here", None, facts)
    return why_no_target(refused.value, facts, image)


@pytest.mark.parametrize("sensor", [pytest.param("720 rows", marks=pytest.mark.slow), "360 rows"])
@pytest.mark.parametrize(
    ("case", "told"),
    [
        ({"angles_deg": BESIDE}, "past the beam"),
        ({"change": half_covered}, "something stands in it"),
        ({"change": with_ghost}, "reflection"),
        ({"change": mirrored}, "mirror"),
    ],
    ids=["past the beam", "half dark", "ghost", "mirrored"],
)
def test_sharp_stars_without_a_tag_are_told_with_what_hides_it(sensor, case, told):
    reason = refusal(sensor, **case)
    assert isinstance(reason, StarsUnnamed)
    assert told in reason.what


@pytest.mark.parametrize("sensor", [pytest.param("720 rows", marks=pytest.mark.slow), "360 rows"])
def test_a_picture_in_which_all_edges_are_wide_is_out_of_focus(sensor):
    assert "out of focus" in refusal(sensor, optics={"psf_px": 4.0}).what
