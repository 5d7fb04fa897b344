"""A port that spoils what passes through it: lost, cut, late, doubled and changed bytes, from a seed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


class NoisyPort:
    """Stands between a driver and a peer in memory."""

    def __init__(self, peer, rng: np.random.Generator, rate: float) -> None:
        self.name = "noisy"
        self.peer = peer
        self.rng = rng
        self.rate = rate
        self.writes = 0
        self.spoiled = 0
        self._held = b""

    def write(self, data: bytes) -> None:
        self.writes += 1
        if len(data) > 1 and self.rng.random() < 0.3 * self.rate:
            self.spoiled += 1
            data = self._change(data[:-1]) + data[-1:]
        self.peer.write(data)

    def read(self, timeout_s: float) -> bytes:
        data = self.peer.read(timeout_s)
        if not data:
            return b""
        if self.rng.random() < self.rate:
            self.spoiled += 1
            faults: list[Callable[[bytes], bytes]] = [
                self._lose,
                self._cut,
                self._change,
                self._double,
                self._hold,
                self._insert,
            ]
            data = faults[self.rng.integers(len(faults))](data)
            if not data:
                return b""
        data, self._held = self._held + data, b""
        return data

    def close(self) -> None:
        self.peer.close()

    def _lose(self, data: bytes) -> bytes:
        return b""

    def _cut(self, data: bytes) -> bytes:
        return data[: self.rng.integers(1, len(data))]

    def _change(self, data: bytes) -> bytes:
        spoiled = bytearray(data)
        for _ in range(self.rng.integers(1, 4)):
            spoiled[self.rng.integers(len(spoiled))] ^= 1 << int(self.rng.integers(8))
        return bytes(spoiled)

    def _double(self, data: bytes) -> bytes:
        return data + data

    def _hold(self, data: bytes) -> bytes:
        """Late: it comes before the next that comes."""
        self._held += data
        return b""

    def _insert(self, data: bytes) -> bytes:
        place = self.rng.integers(len(data))
        return data[:place] + bytes([int(self.rng.integers(256))]) + data[place:]
