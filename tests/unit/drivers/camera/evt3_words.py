"""EVT3 words by name, and what the decoder makes of them as plain lists."""

import numpy as np

from drivers.camera.evt3 import Evt3Decoder

WIDTH, HEIGHT = 1280, 720
LOOP_US = 1 << 24


def high(value):
    return 0x8000 | value


def low(value):
    return 0x6000 | value


def row(y):
    return y


def event(x, p=0):
    return 0x2000 | p << 11 | x


def base(x, p=0):
    return 0x3000 | p << 11 | x


def vector12(bits):
    return 0x4000 | bits


def vector8(bits):
    return 0x5000 | bits


def trigger(value, channel=0):
    return 0xA000 | channel << 8 | value


def others(subtype, count, *, parts=3):
    payload = [0xF000 | count & 0xFFF, 0xF000 | count >> 12 & 0xFFF, 0x7000 | count >> 24 & 0xF]
    return [0xE000 | subtype, *payload[:parts]]


def rows(events):
    return list(zip(*(field.tolist() for field in events), strict=True))


def decode(*words, decoder=None, max_events=1_000_000):
    decoder = decoder or Evt3Decoder(WIDTH, HEIGHT)
    decoded, edges = [], []
    for events, triggers in decoder.decode([np.array(words, np.uint16)], max_events=max_events):
        decoded += rows(events)
        edges += rows(triggers)
    return decoded, edges, decoder.statistics()
