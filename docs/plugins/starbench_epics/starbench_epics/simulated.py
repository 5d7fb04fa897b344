"""caproto's simulated motor record, which can home too, on a server in a thread of its own."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from caproto.asyncio.server import start_server
from caproto.ioc_examples.fake_motor_record import FakeMotor

HOME_DEG, HOMED = 2.0, 1 << 14


class SimulatedRecord:
    """One record on a server of this computer, fresh from power-up."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._motor = FakeMotor(prefix=address, velocity=40.0, user_limits=(-20.0, 20.0), tick_rate_hz=100.0)
        self._loop = asyncio.new_event_loop()
        self._started = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        self._started.wait(10.0)

    def angles_deg(self) -> Mapping[str, float]:
        """Where the axis is."""
        return {"pan": float(self._fields.user_readback_value.value)}

    def unplug(self) -> None:
        """Take the server away. A second call does nothing."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._task.cancel)
            self._thread.join(10.0)

    @property
    def _fields(self) -> Any:
        return self._motor.motor.field_inst

    def _serve(self) -> None:
        self._task = self._loop.create_task(
            start_server(self._motor.pvdb, interfaces=["127.0.0.1"], startup_hook=self._starts)
        )
        try:
            with suppress(asyncio.CancelledError):  # `unplug` ends the server so
                self._loop.run_until_complete(self._task)
        finally:
            for task in asyncio.all_tasks(self._loop):
                task.cancel()
            self._loop.run_until_complete(asyncio.sleep(0.05))
            self._loop.close()

    async def _starts(self, _library: Any) -> None:
        """State what an engineer has configured; then home whenever ``HOMF`` is set."""
        fields = self._fields
        await fields.engineering_units.write("deg")
        await fields.description.write("a simulated record")
        await fields.motor_status.write(0)
        self._started.set()
        while True:
            await asyncio.sleep(0.01)
            if fields.home_forward.value:
                await fields.home_forward.write(0)
                await self._goes_to(HOME_DEG - 1.0)
                await self._goes_to(HOME_DEG)
                await fields.motor_status.write(HOMED)

    async def _goes_to(self, goal_deg: float) -> None:
        await self._motor.motor.write(goal_deg)
        while abs(self._fields.user_readback_value.value - self._motor.motor.value) > 1e-9:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
