"""The contract tests of Starbench, for this driver."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar
from unittest import mock

from starbench_epics.simulated import SimulatedRecord

from bench.extras.plugin_tests import LibraryStageContract


class TestEpicsMotor(LibraryStageContract):
    """Every test of the suite."""

    section: ClassVar[dict[str, Any]] = {
        "driver": "epics_motor",
        "axes": {
            "pan": {"record": "PORT", "limits_deg": [-12, 12], "speed_deg_s": 40, "acceleration_deg_s2": 400}
        },
    }

    @contextmanager
    def connected(self) -> Iterator[SimulatedRecord]:
        """Serve a record on a free port of this computer."""
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = str(free.getsockname()[1])
        here = {
            "EPICS_CA_ADDR_LIST": "127.0.0.1",
            "EPICS_CA_AUTO_ADDR_LIST": "NO",
            "EPICS_CA_SERVER_PORT": port,
        }
        with mock.patch.dict(os.environ, here):
            record = SimulatedRecord("IOC:m1")
            try:
                yield record
            finally:
                record.unplug()
