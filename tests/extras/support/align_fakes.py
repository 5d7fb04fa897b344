"""A bench of fakes for the align page: a stage that takes time, a light, and a camera that records dark slices."""

from contextlib import contextmanager

from fake_devices import FakeDevices
from pages import served

from bench.extras.pages.align.align_app import align_app
from bench.extras.pages.align.live_figures import LiveMeter
from bench.extras.pages.align.session import Session
from bench.stations.station import load_station


def fake_session(devices=None, station="simulated", opener=None):
    """Return a session with fakes, not open yet, and the fakes; ``opener`` takes the place of what opens them."""
    devices = devices or FakeDevices()
    opener = opener or (lambda *_: devices)
    return Session(load_station(str(station)), opener=opener, make_meter=LiveMeter), devices


@contextmanager
def served_bench():
    """Serve the align page of fakes; yields the server, the session and the fakes."""
    session, devices = fake_session()
    session.open()
    with served(align_app(session)) as server:
        yield server, session, devices
    session.close()
