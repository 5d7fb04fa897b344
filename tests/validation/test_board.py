"""A checkerboard on a flickering screen, as OpenCV finds it on event images and calibrates from it."""

import cv2
import numpy as np
import pytest

from calib.events.event_image import make_images
from calib.events.flicker import Flicker
from simulators.config import bench_config
from simulators.errors import ConfigError
from simulators.optics import scene
from simulators.pixels.sensor import simulate
from simulators.world.world import LightState

LIGHT = LightState(output=True, sync=True)
WINDOW_US = 33_400.0


def station(turn_deg, distance_mm, noise="typical"):
    """Bench of a station whose simulation section puts a board before the camera."""
    screen = {
        "columns": 8,
        "rows": 5,
        "square_mm": 20.0,
        "turn_deg": list(turn_deg),
        "position_mm": [0.0, 0.0, distance_mm],
    }
    return bench_config({"screen": screen, "noise": noise, "optics": {"mounting_deg": [0.1, -0.2, 0.3]}})


def seen(config, seed):
    """Event image of a recording, and where the inner corners truly are."""
    truth = config.truth
    picture = scene.picture(truth, {})
    phase = 0.37
    events = simulate(picture, LIGHT, WINDOW_US, phase=phase, noise=truth.noise, camera_seed=3, seed=seed)
    flicker = Flicker(LIGHT.period_us, (1.0 - phase) * LIGHT.period_us, 0.5, 0.0, 0, "triggers")
    size = (truth.camera.width, truth.camera.height)
    images = make_images(events.t, events.x, events.y, events.p, size, flicker, window_us=(0.0, WINDOW_US))
    return images, scene.corners(truth, {})


def found_corners(image):
    """Inner corners as OpenCV finds them, row by row, of an image in which the surroundings are dark."""
    low, high = float(image.min()), float(image.max())
    grey = np.uint8(np.round(255 - 255 * (image - low) / (high - low)))
    ok, corners = cv2.findChessboardCorners(
        cv2.medianBlur(grey, 3), (8, 5), flags=cv2.CALIB_CB_ADAPTIVE_THRESH
    )
    assert ok
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    return cv2.cornerSubPix(cv2.GaussianBlur(grey, (0, 0), 2.0), corners, (11, 11), (-1, -1), stop).reshape(
        -1, 2
    )


def in_order(corners, true):
    """Corners in the order of the true ones; OpenCV may begin at any end of the board."""
    nearest = np.linalg.norm(true[:, None] - corners[None], axis=2).argmin(axis=1)
    assert len(set(nearest)) == len(true)
    return corners[nearest]


@pytest.mark.parametrize(("name", "rms_px"), [("last-polarity", 0.25), ("best", 0.1)])
def test_opencv_finds_the_board_on_event_images(name, rms_px):
    images, true = seen(station((28, 28, 30), 1050), seed=1)
    image = images.best().image if name == "best" else np.abs(images.named(name))
    error = in_order(found_corners(image), true) - true
    assert np.sqrt((error**2).mean()) < rms_px
    assert np.abs(error.mean(axis=0)).max() < 0.06


@pytest.mark.parametrize(
    ("section", "where"),
    [
        ({"rows": 5}, "screen.columns"),
        ({"columns": 1}, "screen.columns"),
        ({"columns": 8, "position_mm": [0, 0, -900]}, "screen.position_mm"),
        ({"columns": 8, "turn_deg": [0, 0]}, "screen.turn_deg"),
    ],
)
def test_a_board_that_cannot_be_is_refused(section, where):
    with pytest.raises(ConfigError) as error:
        bench_config({"screen": section})
    assert error.value.where == where
