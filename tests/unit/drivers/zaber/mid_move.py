"""Events that befall a move some time after it began."""

from __future__ import annotations

import math
from collections.abc import Callable

from tests.unit.drivers.zaber_peer import Controller, ZaberPeer


def once_moving(peer: ZaberPeer, clock, event: Callable[[], None], after_s: float = 0.2) -> None:
    """Let an event happen that long after the first move command."""
    state = {"at_s": math.inf, "done": False}

    def before(request: str) -> None:
        if " move " in request:
            state["at_s"] = clock.now_s + after_s
        if clock.now_s >= state["at_s"] and not state["done"]:
            state["done"] = True
            event()

    peer.before = before


def halt(controller: Controller) -> None:
    controller.start = controller.goal = float(controller.position())
