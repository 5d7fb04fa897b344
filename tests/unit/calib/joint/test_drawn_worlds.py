"""Drawn benches on which the engine was wrong once, by more than the stated uncertainty: it is right now."""

import pytest
from slow_cases import slow

from tests.benchmarks.worlds.catalogue import result
from tests.benchmarks.worlds.scores import ratios

CENTRE = ("fx", "fy", "cx", "cy")
ALL = (*CENTRE, "corner")

#: World, poses, seed, what is known; what is compared, and the most of its error over U; the most of U of fx, px.
BENCHES = [
    # A search forgot the shifts of the image where it starts: the stars at the rim passed for noise, and U was 28 px.
    ("raytraced", 9, 401, "r", ["fx"], 1.0, 3.0),
    # A search that begins 16 % off in the focal length: fields that grew on the way held cy 71 px off at U 13 px.
    ("raytraced-far", 3, 461, "r", ["cy", "fx"], 1.0, 30.0),
    # The coma of a pupil that is stated far off the pivot grows with the square of how far it moves. Expected as small as
    # near the pivot: 2.3 to 6.6 U wrong. 1.43 for cy of seed 425: the truth is less probable by 2 log 11.
    ("raytraced-far", 3, 423, "r", [*ALL, "r"], 1.5, 15.0),
    slow("raytraced-far", 3, 420, "cr", [*ALL, "r"], 1.5, 15.0),
    slow("raytraced-far", 9, 425, "cr", [*ALL, "r"], 1.5, 15.0),
    # Nine poses tell coma that a far pupil sees from another focal length, since that of round glass has a fixed shape.
    # With a free one U was 113 px. Field curvature beside the axes takes a part of what an unstated pupil does.
    slow("raytraced-far", 9, 433, "0", ["fx"], 1.35, 55.0),
    # A wave in the glass that no field holds, of 25 poses: amplitudes ten times as large imitated it, fx was 193 px wrong.
    slow("polynomial", 25, 7, "c", ["fx"], 1.0, 5.0),
    # A hand moves the pupil along the axis by 8.5 mm (1 sigma), which passed for errors of the glass.
    slow("S1", 9, 86, "c", ALL, 1.0, 100.0),
    # A passport allows that another camera looks through the glass elsewhere.
    slow("polynomial", 3, 2, "passport", ["fx", "cx", "cy", "corner"], 1.3, 100.0),
    # A search with any amplitudes has long first steps. With those of the start it ended 5 U away.
    slow("S1", 9, 76, "0", ["fx"], 1.0, 200.0),
    # The discs of three poses show no gimbal. As if on a gimbal, fx was 43 px wrong with U of 32 px.
    slow("product-S1", 3, 73, "0", ["fx"], 1.0, 200.0),
    # Three poses of a hand: each is 1.7 to 2.7 U wrong in one of both ways.
    slow("S1", 3, 406, "0", ["fx", "cx", "cy"], 1.3, 500.0),
    slow("S1", 3, 407, "0", ["fx", "cx", "cy"], 1.3, 500.0),
    slow("product-S1", 3, 404, "0", ["fx", "cx", "cy"], 1.3, 500.0),
    # The places of the pupil were what the discs show, and the fields by turn of low degree: 43 and 64 px off.
    slow("product-S1", 25, 51, "c", ["fx"], 1.0, 15.0),
    slow("S1", 25, 11, "c", ["fx"], 1.0, 15.0),
    # Linear equations alone promised a print that is 52 % too small: fx 265 px wrong, residuals of 199 px.
    slow("S2", 25, 53, "c", ["fx"], 1.0, 15.0),
    # Own fields of 25 poses seemed independent where an error follows the turn: 2.5 U wrong. Now it is 1.2 U.
    slow("product-S1", 25, 62, "0", ["fx"], 1.3, 15.0),
    # Nothing is stated of a mount moved by hand: U is wide, and holds.
    *(slow("product-S1", 9, seed, "0", ["fx"], 1.0, 500.0) for seed in range(100, 104)),
]


@pytest.mark.parametrize(("world", "poses", "seed", "known", "names", "most_over_u", "most_u_px"), BENCHES)
def test_the_camera_lies_within_its_uncertainty(world, poses, seed, known, names, most_over_u, most_u_px):
    line = result(world, poses, seed, known)
    assert {
        name: float(ratios([line], name)[0]) for name in names if ratios([line], name) >= most_over_u
    } == {}
    assert line["U"]["fx"] < most_u_px
    assert line["left_out_px"] is None or line["left_out_px"] < 0.5
