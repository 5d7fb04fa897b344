"""A simulated frame camera: a network camera that sends its grey pictures, uncompressed, to whoever connects.

It speaks YUV4MPEG2 over TCP: one line that tells size and rate, then for each picture a line ``FRAME`` and its
bytes. Every connection is sent pictures from its own begin on, at the camera's rate, until the host hangs up. What
is in a picture is a function of the seed, the resting pose, the light, how many connections were made at exactly
these before, and the picture's number.
"""

from __future__ import annotations

import hashlib
import json
import select
import socket
import threading
from contextlib import suppress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulators.optics import scene
from simulators.world.world import LightState, World

RATE_HZ: Final = 25
EXPOSURE_S: Final = 0.010
FULL_WELL: Final = 10_000.0
"""Electrons at which a pixel is full, and its grey value 255."""
FULL_LIGHT_ELECTRONS: Final = 8_000.0
"""What white paper gives at nominal brightness in an exposure."""
DARK_ELECTRONS: Final = 60.0
READ_NOISE_ELECTRONS: Final = 12.0
PIXEL_SPREAD: Final = 0.006
"""1-sigma of the pixels' sensitivities."""
LIGHT_SAMPLES: Final = 32
"""Moments of an exposure at which the light is looked at."""
POLL_S: Final = 0.1
"""How often waiting threads look whether they are to end."""


class PictureMaker:
    """Pictures of a world, one connection after another.

    Parameters
    ----------
    world
        Where the axes point and what the light does.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        camera = world.truth.camera
        self.size = camera.width, camera.height
        spread = np.random.default_rng(np.random.SeedSequence([world.camera_seed, 1]))
        shape = camera.height, camera.width
        self._sensitivity = 1.0 + PIXEL_SPREAD * spread.standard_normal(shape, np.float32)
        self._repeats: dict[str, int] = {}
        self._scene_cache: tuple[object, NDArray[np.float32]] | None = None

    def connection_seed(self) -> np.random.SeedSequence:
        """Give the seed of a connection that begins now."""
        now_s = self._world.now_s()
        key = json.dumps(
            {
                "microsteps": dict(self._world.resting_microsteps(now_s)),
                "settled": self._world.is_settled(now_s),
                "light": self._world.light(now_s).settings(),
            },
            sort_keys=True,
        )
        repeat = self._repeats.get(key, 0)
        self._repeats[key] = repeat + 1
        digest = hashlib.sha256(key.encode()).digest()
        return np.random.SeedSequence([self._world.seed, repeat, *np.frombuffer(digest[:16], "<u4").tolist()])

    def expose(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Expose now: (height, width) grey values."""
        begin_s = self._world.now_s()
        light = self._world.light(begin_s)
        electrons = FULL_LIGHT_ELECTRONS * mean_brightness(light, begin_s, EXPOSURE_S) * self._scene(begin_s)
        electrons = electrons * self._sensitivity + DARK_ELECTRONS
        electrons = electrons + np.sqrt(electrons) * rng.standard_normal(electrons.shape, np.float32)
        electrons += READ_NOISE_ELECTRONS * rng.standard_normal(electrons.shape, np.float32)
        grey: NDArray[np.uint8] = np.clip(np.rint(electrons * (255.0 / FULL_WELL)), 0, 255).astype(np.uint8)
        return grey

    def _scene(self, begin_s: float) -> NDArray[np.float32]:
        """Share of the light in each pixel; what moves meanwhile is blurred."""
        moments = (begin_s,) if self._world.is_settled(begin_s) else (begin_s, begin_s + EXPOSURE_S / 2)
        truth, poses = self._world.truth_at(begin_s), [self._world.angles_deg(moment) for moment in moments]
        if self._scene_cache is None or self._scene_cache[0] != (truth, poses):
            seen = [scene.picture(truth, pose) for pose in poses]
            self._scene_cache = (truth, poses), np.mean(seen, axis=0, dtype=np.float32)
        return self._scene_cache[1]


def mean_brightness(light: LightState, begin_s: float, exposure_s: float) -> float:
    """Average the light over an exposure; nominal brightness = 1."""
    if not light.output:
        return 0.0
    instants = begin_s + (np.arange(LIGHT_SAMPLES) + 0.5) / LIGHT_SAMPLES * exposure_s
    phases = np.array([light.phase_at(float(t)) for t in instants])
    if light.waveform == "sine":
        shares = 0.5 + 0.5 * np.sin(2.0 * np.pi * phases)
    else:
        shares = (phases < light.high_share).astype(np.float64)
    return float(np.mean(light.low + (light.high - light.low) * shares))


#: What can go wrong with the camera, by name.
FRAME_CAMERA_FAULTS: Final = {
    "unplug": "the camera goes away, and answers no more",
    "silence": "pictures no longer come, and nobody says why",
    "frozen": "the last picture comes again and again",
    "mend": "all is well again",
}


class SimulatedFrameCamera:
    """The camera, listening for hosts, one after another.

    Parameters
    ----------
    world
        The world it looks at.
    host, port
        Where it listens; port 0 takes a free one.
    """

    def __init__(self, world: World, *, host: str = "127.0.0.1", port: int = 0) -> None:
        self._pictures = PictureMaker(world)
        self._closing = threading.Event()
        self._fault = ""
        self._last = b""
        self._listener = socket.create_server((host, port))
        self._thread = threading.Thread(target=self._listen, name="simulated-frame-camera", daemon=True)

    @property
    def address(self) -> str:
        """Where it listens, as a URL."""
        host, port = self._listener.getsockname()[:2]
        return f"tcp://{host}:{port}"

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def close(self) -> None:
        """Hang up and stop listening; returns when the thread has ended."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        self._listener.close()

    def inject_fault(self, fault: str) -> None:
        """Let one of `FRAME_CAMERA_FAULTS` happen from now on, in place of any before."""
        self._fault = "" if fault == "mend" else fault

    def _listen(self) -> None:
        while not self._closing.is_set():
            if not select.select([self._listener], [], [], POLL_S)[0]:
                continue
            link, _ = self._listener.accept()
            link.settimeout(POLL_S)
            if self._fault == "unplug":
                link.close()
                continue
            with link, suppress(OSError):  # the host has hung up: that is how it says that it has enough
                self._stream(link)

    def _stream(self, link: socket.socket) -> None:
        """Send pictures until the host hangs up or the camera is closed."""
        width, height = self._pictures.size
        rng = np.random.default_rng(self._pictures.connection_seed())
        self._send(link, f"YUV4MPEG2 W{width} H{height} F{RATE_HZ}:1 Ip A1:1 Cmono\n".encode())
        while not self._closing.wait(1.0 / RATE_HZ) and self._fault != "unplug":
            if self._fault == "silence":
                continue
            if self._fault != "frozen" or not self._last:
                self._last = self._pictures.expose(rng).tobytes()
            self._send(link, b"FRAME\n" + self._last)

    def _send(self, link: socket.socket, data: bytes) -> None:
        """Send all, however slowly the host reads; raises OSError when it has gone or the camera is closed."""
        rest = memoryview(data)
        while rest:
            if self._closing.is_set() or self._fault == "unplug":
                raise ConnectionAbortedError
            with suppress(TimeoutError):
                rest = rest[link.send(rest) :]
