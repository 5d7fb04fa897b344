"""A solved run on the disk, made in seconds by the program's own writers; its stars are expected ones, with noise."""

from unittest import mock

import cv2
import numpy as np
from rehearsed import Scene

from bench.batch.rehearsal import RehearsedKind
from bench.measure.measure import Measurement, StoredImage
from bench.solve.result import ResultWriter

POSES = (
    "[{name: left, pan_deg: -5}, {name: right, pan_deg: 5}, {name: above, tilt_deg: 2, pan_deg: 1},"
    " {name: below, tilt_deg: -2, pan_deg: -1}]"
)
END = "  - solve: {model: %s, distortion: [k1]}\n  - report\n"
IMAGE = {"kind": "fired-per-edge", "reason": "made up", "window_us": [0, 8400], "periods": 2}


def image_of(view):
    """The stars of a view as dots."""
    width, height = view.image_size
    image = np.full((height, width), 128, np.uint8)
    for u, v in view.points_px:
        cv2.circle(image, (round(u), round(v)), 3, 255, -1)
    return image


def write_solved_run(folder, *, model="spherical", poses=POSES, end=END):
    """Write a run into ``folder / "run"``, with results, views, exports and an empty report; return its folder.

    It is not sealed, and its recordings hold stars instead of events.
    """
    scene = Scene(folder, poses=poses, end=end % model if "%s" in end else end)
    measure = RehearsedKind.measure

    def measured(self, *words):
        pose = measure(self, *words)
        if pose.view is None:
            return pose
        image = StoredImage.from_image(image_of(pose.view))
        return Measurement(pose.view, image, {**pose.facts, "image": IMAGE})

    with (
        mock.patch("bench.batch.rehearsal.RehearsedResults", ResultWriter),
        mock.patch("bench.solve.result.render_report", return_value="<!DOCTYPE html>"),  # it takes seconds
        mock.patch.object(RehearsedKind, "measure", measured),
    ):
        ended = scene.run()
    assert ended.how == "finished", ended.why
    return scene.folder
