"""A simulated network camera that sends uncompressed grey pictures to each host that connects.

The camera speaks YUV4MPEG2 over TCP: first one line with size and rate, then for each picture a line ``FRAME`` and
its bytes. It sends pictures at its own rate until the host closes the connection. Pictures depend on the seed, the
resting pose, the light, the number of earlier connections with the same pose and light, and the number of the
picture: equal runs get equal pictures.
"""

from __future__ import annotations

import json
import socket
from contextlib import suppress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulators.cameras.streaming import POLL_S, CameraServer
from simulators.optics import scene
from simulators.world.world import LightState, World

RATE_HZ: Final = 25  # As the exposure, common with machine-vision cameras (own choice)
EXPOSURE_S: Final = 0.010
FULL_WELL: Final = 10_000.0
"""Electrons at which a pixel is saturated (grey value 255). As the next four, of the size of small industrial cameras
(own choice)."""
FULL_LIGHT_ELECTRONS: Final = 8_000.0
"""Electrons of a white pixel in one exposure at nominal brightness."""
DARK_ELECTRONS: Final = 60.0
READ_NOISE_ELECTRONS: Final = 12.0
PIXEL_SPREAD: Final = 0.006
"""Relative standard deviation of the pixels' sensitivities."""
LIGHT_SAMPLES: Final = 32
"""Number of moments in an exposure at which the light is sampled: a flicker of 60 Hz changes little between two."""


class PictureMaker:
    """Exposes pictures of a world, with noise by EMVA Standard 1288: shot noise, dark current, read noise."""

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
        """Return a connection's seed: of bench, resting pose, light, and the number of earlier ones with the same."""
        key = json.dumps(self._world.situation(self._world.now_s()), sort_keys=True)
        return self._world.recording_seed(key, self._repeats)

    def expose(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Expose one picture, beginning now: ``(height, width) uint8`` grey values."""
        begin_s = self._world.now_s()
        light = self._world.light(begin_s)
        electrons = FULL_LIGHT_ELECTRONS * mean_brightness(light, begin_s) * self._scene(begin_s)
        electrons = electrons * self._sensitivity + DARK_ELECTRONS
        electrons = electrons + np.sqrt(electrons) * rng.standard_normal(electrons.shape, np.float32)
        electrons += READ_NOISE_ELECTRONS * rng.standard_normal(electrons.shape, np.float32)
        grey: NDArray[np.uint8] = np.clip(np.rint(electrons * (255.0 / FULL_WELL)), 0, 255).astype(np.uint8)
        return grey

    def _scene(self, begin_s: float) -> NDArray[np.float32]:
        """Return the share of the light in each pixel; a moving scene is the mean of two moments."""
        moments = (begin_s,) if self._world.is_settled(begin_s) else (begin_s, begin_s + EXPOSURE_S / 2)
        truth, poses = self._world.truth_at(begin_s), [self._world.angles_deg(moment) for moment in moments]
        if self._scene_cache is None or self._scene_cache[0] != (truth, poses):
            seen = [scene.picture(truth, pose) for pose in poses]
            self._scene_cache = (truth, poses), np.mean(seen, axis=0, dtype=np.float32)
        return self._scene_cache[1]


def mean_brightness(light: LightState, begin_s: float) -> float:
    """Return the mean brightness of the light over an exposure, by the midpoint rule."""
    if not light.output:
        return 0.0
    instants = begin_s + (np.arange(LIGHT_SAMPLES) + 0.5) / LIGHT_SAMPLES * EXPOSURE_S
    phases = np.array([light.phase_at(float(t)) for t in instants])
    if light.waveform == "sine":
        shares = 0.5 + 0.5 * np.sin(2.0 * np.pi * phases)
    else:
        shares = (phases < light.high_share).astype(np.float64)
    return float(np.mean(light.low + (light.high - light.low) * shares))


class SimulatedFrameCamera(CameraServer):
    """The simulated frame camera; it serves one host after another."""

    def __init__(self, world: World) -> None:
        super().__init__("simulated-frame-camera")
        self._pictures = PictureMaker(world)
        self._fault = ""
        self._last = b""

    @property
    def address(self) -> str:
        """URL of the camera, ``tcp://host:port``."""
        return f"tcp://{super().address}"

    def inject_fault(self, fault: str) -> None:
        """Set one of `streaming.FRAME_CAMERA_FAULTS`, which replaces an earlier one from now on; ``mend`` clears it."""
        self._fault = "" if fault == "mend" else fault

    def _meet(self, link: socket.socket) -> None:
        link.settimeout(POLL_S)
        with link, suppress(OSError):  # a host ends the stream by closing the connection
            if self._fault != "unplug":
                self._stream(link)

    def _stream(self, link: socket.socket) -> None:
        """Send pictures until the host closes the connection or the camera is closed."""
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
        """Send all bytes, however slowly the host reads them; OSError if host or camera has closed the connection."""
        rest = memoryview(data)
        while rest:
            if self._closing.is_set() or self._fault == "unplug":
                raise ConnectionAbortedError
            with suppress(TimeoutError):
                rest = rest[link.send(rest) :]
