"""Choose what a run does with a station's camera: by the kind of camera, and by whether it looks at a board.

This module opens nothing. What each kind does is in `camera_kinds` and `board_kinds`.
"""

from __future__ import annotations

from bench.stations.station import Station
from bench.stations.station_cameras import FrameCameraConfig
from bench.views.board_kinds import EventBoardKind, FrameBoardKind
from bench.views.camera_kinds import CameraKind, EventKind, FrameKind


def camera_kind(station: Station) -> CameraKind:
    """Return the kind of a station's camera."""
    config, shown = station.camera, station.board
    if shown is not None:
        if isinstance(config, FrameCameraConfig):
            return FrameBoardKind(config.pictures, config.settings(), shown.board())
        return EventBoardKind(config.biases.model_dump(), shown.board(), config.roi)
    if isinstance(config, FrameCameraConfig):
        return FrameKind(config.pictures, config.settings())
    return EventKind(config.biases.model_dump(), config.roi)
