"""Parsing of orders for faults, and faults of the lamp that its driver does not notice."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.errors import ConfigError
from simulators.faults.catalogue import FaultOrder, fault_order, fault_order_from_text
from simulators.lights.lamp import Lamp
from simulators.world.world import LightState, SyncLine


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("pan stall share=0.3", FaultOrder("pan", "stall", {"share": 0.3, "skip": 0})),
        ("tilt reboot after_s=2", FaultOrder("tilt", "reboot", {}, 2.0)),
        ("light lamp_open", FaultOrder("light", "lamp_open", {})),
        ("light wrong_frequency factor=0.9", FaultOrder("light", "wrong_frequency", {"factor": 0.9})),
        ("camera fault message='too hot'", FaultOrder("camera", "fault", {"message": "too hot"})),
    ],
)
def test_an_order_is_read_as_typed(text, expected):
    assert fault_order_from_text(text) == expected


@pytest.mark.parametrize(
    ("given_order", "where"),
    [
        ({}, "device"),
        ({"device": "pan"}, "fault"),
        ({"device": "yaw", "fault": "stall"}, "device"),
        ({"device": "pan", "fault": "late"}, "fault"),
        ({"device": "pan", "fault": "stall", "when": 1}, "when"),
        ({"device": "pan", "fault": "stall", "share": "half"}, "share"),
        ({"device": "pan", "fault": "stall", "after_s": None}, "after_s"),
    ],
)
def test_a_wrong_order_names_its_key(given_order, where):
    with pytest.raises(ConfigError) as caught:
        fault_order(given_order)
    assert caught.value.where == where


@given(st.text(max_size=60))
def test_any_text_is_an_order_or_a_clear_error(text):
    with suppress(ConfigError):
        assert fault_order_from_text(text).device in {"pan", "tilt", "roll", "gimbal", "light", "camera"}


# ---------------------------------------------------------------- the lamp
LIT = LightState(low_v=0.0, high_v=5.0, output=True, sync=True)


@pytest.mark.parametrize(
    ("kind", "factor", "name", "value"),
    [
        ("lamp_open", 1.0, "high", 0.0),
        ("dim", 0.25, "high", 0.25),
        ("wrong_frequency", 2.0, "frequency_hz", 120.0),
        ("wrong_duty", 0.5, "duty_percent", 25.0),
        ("no_sync", 1.0, "sync", False),
        ("sync_inverted", 1.0, "sync_line", SyncLine(inverted=True)),
        ("sync_missing", 3.0, "sync_line", SyncLine(missing_every=3)),
        ("sync_extra", 4.0, "sync_line", SyncLine(extra_every=4)),
        ("sync_jitter", 0.06, "sync_line", SyncLine(jitter_us=1000.0)),
    ],
)
def test_lamp_and_sync_cable_fail_at_once_and_until_they_are_mended(kind, factor, name, value):
    shown: list[LightState] = []
    lamp = Lamp(shown.append)
    lamp.drive(LIT)
    lamp.inject_fault(kind, factor)
    assert getattr(shown[-1], name) == pytest.approx(value)
    lamp.drive(LIT)
    assert getattr(shown[-1], name) == pytest.approx(value)
    lamp.clear_faults()
    assert shown[-1] == LIT


PERIOD = 16_667


def carried(line: SyncLine, first: int = 0, count: int = 60) -> list[tuple[int, int]]:
    k = np.arange(first, first + count)
    t, value = line.carry(k, k * PERIOD, k * PERIOD + PERIOD // 2, float(PERIOD))
    return list(zip(t.tolist(), value.tolist(), strict=True))


def test_a_swapped_sync_cable_carries_low_for_high():
    assert [(t, 1 - value) for t, value in carried(SyncLine(inverted=True))] == carried(SyncLine())


def test_lost_and_stray_pulses_come_in_pairs_at_their_periods():
    lost = set(carried(SyncLine())) - set(carried(SyncLine(missing_every=20)))
    assert {t // PERIOD for t, _ in lost} == {0, 20, 40}
    stray = [edge for edge in carried(SyncLine(extra_every=30)) if edge not in carried(SyncLine())]
    assert [(t // PERIOD, value) for t, value in stray] == [(0, 1), (0, 0), (30, 1), (30, 0)]


def test_jitter_is_bounded_even_and_of_each_edge_its_own():
    late = np.array(
        [
            a - b
            for (a, _), (b, _) in zip(
                carried(SyncLine(jitter_us=500.0), 0, 2000), carried(SyncLine(), 0, 2000), strict=True
            )
        ]
    )
    assert np.abs(late).max() <= 500
    assert abs(late.mean()) < 20
    assert late.std() == pytest.approx(500 / 3**0.5, rel=0.05)
    assert len(np.unique(late)) > 800
    alone = carried(SyncLine(jitter_us=500.0), 5, 1)
    assert set(alone) <= set(carried(SyncLine(jitter_us=500.0)))
