"""What tests of whole devices and runs share: a browser, a home, a run of three poses, a disk, a turned clock."""

import time

import pytest
from align_browser import running_chromium
from own_disk import Disk
from running import called
from shared_folder import shared_folder

from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice
from tests.hil.direct_stages import VirtualClock, of_one_port


@pytest.fixture(scope="module")
def chromium():
    with running_chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="session")
def three_pose(tmp_path_factory):
    """Folder of the shipped run of three poses: `run`, its `home`, and what the command said: `stdout`, `stderr`."""

    def make(folder):
        words = ("run", "three_pose", "-s", "simulated", "--seed", 7, "-o", folder / "run", "--json")
        ended = called(*words, home=folder / "home")
        for stream in ("stdout", "stderr"):
            (folder / stream).write_text(getattr(ended, stream))

    return shared_folder(tmp_path_factory, "three-pose", make)


@pytest.fixture
def disk(tmp_path):
    """A file system of the test's own."""
    disk = Disk(tmp_path)
    yield disk
    disk.close()


@pytest.fixture
def zaber_port(tmp_path):
    """The port of two chained Zaber controllers."""
    chain, _ = of_one_port("zaber", time.monotonic)
    with SerialDevice(PseudoTerminal(tmp_path / "gimbal"), chain) as device:
        yield device.address


@pytest.fixture
def clock():
    return VirtualClock()
