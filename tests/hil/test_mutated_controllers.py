"""Simulated controllers with one thing wrong each: our drivers refuse every one, before or while it moves."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import MoveFailed, MoveTimeout, ReplyError
from tests.hil.direct_stages import FAMILIES, DirectStage, VirtualClock
from tests.hil.mutated import XIMC, ZABER, Mutated

pytestmark = pytest.mark.usefixtures("never_late")

REPORTED_WRONGLY = {"always idle", "never idle"}
"""Those lie about motion in replies of perfect form: only a motion can show it."""
LONGEST_S = 60.0


def mutated(family: str, change) -> tuple[DirectStage, VirtualClock]:
    """Open nothing: a simulated controller of that family behind the change, and what reopens the driver."""
    clock = VirtualClock()
    rig = FAMILIES[family](clock, np.random.default_rng(1))
    rig.line.device = Mutated(rig.line.device, change)
    return rig, clock


def use(rig: DirectStage) -> None:
    """Open the driver anew, home and move, as a run does."""
    stage = rig.reopen()
    stage.home()
    stage.move_to({"pan": -9.0})


@pytest.mark.parametrize(
    ("family", "name"), [*(("zaber", name) for name in ZABER), *(("ximc", name) for name in XIMC)]
)
def test_a_controller_with_one_thing_wrong_is_refused_in_bounded_time(family, name) -> None:
    rig, clock = mutated(family, {"zaber": ZABER, "ximc": XIMC}[family][name])
    standing_deg = rig.controller.axis.pointing.angle_deg(clock.now_s)
    began_s = clock.now_s
    with pytest.raises((ReplyError, MoveFailed, MoveTimeout)):
        use(rig)
    assert clock.now_s - began_s < LONGEST_S
    if name not in REPORTED_WRONGLY:
        assert rig.controller.axis.pointing.angle_deg(clock.now_s) == standing_deg


@pytest.mark.parametrize("family", ["zaber", "ximc"])
def test_the_same_controller_with_nothing_wrong_is_used(family) -> None:
    rig, clock = mutated(family, lambda answer: answer)
    use(rig)
    assert rig.controller.axis.pointing.angle_deg(clock.now_s + 1.0) == pytest.approx(-9.0, abs=0.002)
