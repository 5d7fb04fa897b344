"""A bench of fakes for the align page: a stage that takes time, a light, and a camera that records dark slices."""

import shutil
from contextlib import contextmanager

from fake_devices import FakeDevices
from pages import served

from bench.extras.pages.align.align_app import align_app
from bench.extras.pages.align.live_figures import LiveMeter
from bench.extras.pages.align.page_requests import PageFiles
from bench.extras.pages.align.session import Session
from bench.stations.station import SHIPPED_STATIONS, load_station


def fake_session(devices=None, station="simulated", opener=None):
    """Return a session with fakes, not open yet, and the fakes; ``opener`` takes the place of what opens them."""
    devices = devices or FakeDevices()
    return Session(
        load_station(str(station)), opener=opener or (lambda *_: devices), make_meter=LiveMeter
    ), devices


@contextmanager
def served_bench(folder):
    """Serve the align page of fakes; yields the server, the session and the fakes."""
    path = folder / "bench.yaml"
    shutil.copy(SHIPPED_STATIONS / "simulated.yaml", path)
    session, devices = fake_session(station=path)
    session.open()
    with served(align_app(session, PageFiles(str(path), folder))) as server:
        yield server, session, devices
    session.close()
