"""A file of events, read at once."""

from types import SimpleNamespace

import numpy as np

from drivers.camera.event_arrays import Events, empty_events, join_triggers
from drivers.camera.formats.event_files import open_events


def import_events(path, choices=None):
    """What `open_events` tells of a file, with all its events in memory."""
    with open_events(path, choices) as source:
        pieces = list(source.pieces())
        parts = [empty_events(0), *(events for events, _ in pieces)]
        return SimpleNamespace(
            events=Events(*(np.concatenate(column) for column in zip(*parts, strict=True))),
            triggers=join_triggers([edges for _, edges in pieces]),
            width=source.width,
            height=source.height,
            header=source.header,
            truncated=source.truncated,
        )
