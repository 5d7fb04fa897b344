"""The hands at the simulated camera."""

import json
from unittest.mock import Mock

import numpy as np
import pytest

from bench.base.errors import ControlRefused
from bench.extras.pages.align.simulated_hands import SimulatedHands


def simulation(answer):
    """A simulated bench that notes its orders."""
    return Mock(order=Mock(return_value=answer))


def test_hands_turn_the_lens_of_a_simulated_bench_only():
    bench = simulation(json.dumps({"ok": True, "now": {"ring_deg": 5.0}}))
    hands = SimulatedHands(bench)
    assert hands.do("lens turn", {"deg": 5.0}) == {"ring_deg": 5.0}
    bench.order.assert_called_once_with("lens turn deg=5")
    assert hands.seen == {"ring_deg": 5.0}
    with pytest.raises(ControlRefused, match="is real"):
        SimulatedHands(None).do("lens turn", {"deg": 5.0})


@pytest.mark.parametrize(
    ("action", "numbers"),
    [
        ("lens break", {}),
        ("pan stall", {"share": 1.0}),
        ("lens turn", {"x": 1}),
        ("lens turn", {"deg": np.inf}),
    ],
)
def test_hands_do_only_what_hands_can_do(action, numbers):
    bench = simulation("{}")
    with pytest.raises(ControlRefused):
        SimulatedHands(bench).do(action, numbers)
    bench.order.assert_not_called()


@pytest.mark.parametrize("answer", ["", '{"ok": false, "error": "f_number must be above 0"}'])
def test_a_refused_order_is_said(answer):
    with pytest.raises(ControlRefused, match=r"did not answer|f_number"):
        SimulatedHands(simulation(answer)).do("lens aperture", {"f_number": 0.0})
