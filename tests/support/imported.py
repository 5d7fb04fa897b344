"""A file of events, read at once."""

from types import SimpleNamespace

import numpy as np

from drivers.camera.event_arrays import Events, empty_events
from drivers.camera.formats.event_files import open_events


def import_events(path, choices=None):
    """What `open_events` tells of a file, with all its events in memory."""
    with open_events(path, choices) as source:
        pieces = [empty_events(0), *source.pieces()]
        return SimpleNamespace(
            events=Events(*(np.concatenate(column) for column in zip(*pieces, strict=True))),
            triggers=source.triggers,
            width=source.width,
            height=source.height,
            header=source.header,
        )
