"""How far the stars moved between the halves of a recording, against the simulated truth: half of it from each of two poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slow_cases import first_quick
from still_picture import simulate

from calib import detect_view, make_images
from calib.events.flicker import Flicker
from calib.stars.motion import shift_between_halves
from simulators.optics.picture import TARGET, pose_rotation, project, render
from simulators.world.truth import NOISE_LEVELS, Truth
from simulators.world.world import LightState

SIZE, WINDOW_US, PHASE = (1280, 720), 66_000.0, 0.3
LIGHT = LightState(waveform="square", output=True, sync=True)
FLICKER = Flicker(
    LIGHT.period_us, -PHASE * LIGHT.period_us % LIGHT.period_us, LIGHT.high_share, 0.0, 0, "triggers"
)


def _images(truth, rotation, seed, noise):
    events = simulate(
        render(truth, rotation),
        LIGHT,
        WINDOW_US,
        phase=PHASE,
        noise=NOISE_LEVELS[noise],
        camera_seed=7,
        seed=seed,
    )
    return make_images(*events, SIZE, FLICKER, window_us=(0.0, WINDOW_US))


@pytest.mark.parametrize(
    ("shift_px", "noise", "roll_deg"),
    first_quick([(0.05, "heavy", 17), (0.3, "typical", 45), (1.0, "heavy", 0)]),
)
def test_the_shift_between_the_halves_is_right_to_a_hundredth_of_a_pixel(shift_px, noise, roll_deg):
    truth = Truth()
    rotation = pose_rotation({"pan": 1.0, "tilt": -1.0, "roll": roll_deg}, truth.optics)
    turned = Rotation.from_rotvec(shift_px / truth.camera.fx * np.array([0.6, 0.8, 0])).as_matrix() @ rotation
    whole = _images(truth, rotation, 1, noise)
    first, second = whole.halves[0], _images(truth, turned, 2, noise).halves[1]
    view = detect_view(whole.best().image, TARGET)
    seen = np.asarray(TARGET.positions_mm(view.ids))
    true = np.median(project(seen, turned, truth) - project(seen, rotation, truth), axis=0)
    assert shift_between_halves(first, second, view, TARGET) == pytest.approx(true, abs=0.01)
