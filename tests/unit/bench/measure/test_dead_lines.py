"""Dead columns and rows of a sensor move no star: those that they cross are left out, and the lines are told."""

import numpy as np
from virtual_camera import QUARTER, VirtualCamera

from bench.measure.measure import EventData, find_stars, whole_image, without_crossed
from bench.solve.solution import silent_line_notes
from calib.target import StarTarget
from drivers.camera.event_arrays import Events, Triggers

COLUMNS, ROWS = (200, 300, 301, 302, 450), (90, 91)
NO_EDGES = Triggers(np.empty(0, np.int64), np.empty(0, np.uint8), np.empty(0, np.uint8))


def seen(events, size):
    """Return the view of a recording, and its facts."""
    facts = {}
    whole = whole_image(EventData(events, NO_EDGES, size, 0), "auto", 4, 240.0, facts)
    view = find_stars(whole.image, StarTarget(), "here", None, facts)
    return without_crossed(view, whole.silent, np.array(facts["grid"]), StarTarget()), facts


def test_stars_beside_dead_lines_stay_where_they_are_and_the_lines_are_told():
    taken = VirtualCamera({"camera": QUARTER}, 1).capture({"tilt": -3.0}, seed=3, light_hz=240.0, periods=4)
    alive = ~np.isin(taken.events.x, COLUMNS) & ~np.isin(taken.events.y, ROWS)
    whole, healthy = seen(Events(*taken.events), taken.image_size)
    cut, facts = seen(Events(*(part[alive] for part in taken.events)), taken.image_size)
    assert (facts["image"]["silent_columns"], facts["image"]["silent_rows"]) == (5, 2)
    common = np.isin(whole.ids, cut.ids)
    assert np.abs(whole.points_px[common] - cut.points_px).max() < 0.03
    assert 150 < len(cut) < len(whole)
    assert silent_line_notes([healthy]) == []
    (note,) = silent_line_notes([healthy, facts])
    assert "5 columns and 2 rows" in note
