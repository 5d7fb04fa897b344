"""The paper's camera before a narrow beam, and three poses of it: what the simulated numbers are told for."""

from calib import CameraModel, Collimator, ExpectedBench, StarTarget

#: Stars 26 px apart, 4.5 degrees of half angle, r = 700 mm.
PITCH = 5.45
NARROW = ExpectedBench(
    CameraModel(3345.0, 3345.0, 642.0, 363.0, (1280, 720), {"k1": 0.06, "k2": -0.9}),
    Collimator(24 * PITCH, 35 * PITCH, 700.0),
    4.5,
    0.05,
    StarTarget(pitch_mm=PITCH),
    needs_tag=False,
)
POSES = [
    {"pan_deg": -6.0, "tilt_deg": 1.5},
    {"pan_deg": 1.0, "tilt_deg": -3.0, "roll_deg": 20.0},
    {"pan_deg": 5.0, "tilt_deg": 2.5, "roll_deg": -20.0},
]
