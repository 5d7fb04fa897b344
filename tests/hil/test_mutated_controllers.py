"""Simulated controllers with one thing wrong each: our drivers refuse every one, before or while it moves."""

import pytest

from drivers.errors import MoveFailed, MoveTimeout, ReplyError
from drivers.stage import Stage
from tests.hil.direct_stages import rig_of
from tests.hil.mutated import XIMC, ZABER, Mutated

pytestmark = pytest.mark.usefixtures("never_late")

REPORTED_WRONGLY = {"always idle", "never idle"}
"""Those lie about motion in replies of perfect form: only a motion can show it."""
LONGEST_S = 60.0


def use(stage: Stage) -> None:
    """Home and move, as a run does."""
    stage.home()
    stage.move_to({"pan": -9.0})


@pytest.mark.parametrize(
    ("family", "name"), [*(("zaber", name) for name in ZABER), *(("ximc", name) for name in XIMC)]
)
def test_a_controller_with_one_thing_wrong_is_refused_in_bounded_time(family, name) -> None:
    rig = rig_of(family)
    clock = rig.line.clock
    rig.line.device = Mutated(rig.line.device, {"zaber": ZABER, "ximc": XIMC}[family][name])
    standing_deg = rig.present_deg()
    began_s = clock.now_s
    with pytest.raises((ReplyError, MoveFailed, MoveTimeout)):
        use(rig.reopen())
    assert clock.now_s - began_s < LONGEST_S
    if name not in REPORTED_WRONGLY:
        assert rig.present_deg() == standing_deg
