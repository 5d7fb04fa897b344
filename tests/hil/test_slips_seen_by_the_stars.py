"""An axis without encoder that slips between two poses: its driver cannot know, but the stars do, and the result holds."""

import pytest
from running import results, starbench

from calib.model.cause import SLIPPED

STATION = """\
format: starbench/station/1
name: Simulated bench with a home-built gimbal
simulation:
  stage:
    kind: grbl
    pan: {{limit_deg: 15, microsteps_per_deg: 6400}}
    tilt: {{limit_deg: 10, microsteps_per_deg: 6400}}
  faults: [{faults}]
stage:
  driver: grbl
  port: sim:gimbal
  axes:
    pan: {{letter: X, steps_per_deg: 6400, zero_deg: 16, limits_deg: [-15, 15], speed_deg_s: 40, acceleration_deg_s2: 200}}
    tilt: {{letter: Y, steps_per_deg: 6400, zero_deg: 11, limits_deg: [-10, 10], speed_deg_s: 40, acceleration_deg_s2: 200}}
light: {{driver: scpi, port: sim:light, serial: SG0042}}
camera: {{driver: simulated_evk4, address: sim:camera, serial: 00050423}}
"""
SLIP = "{device: pan, fault: slip, share: 0.98, skip: 4}"
"""A small part of one move, to the fourth of nine poses."""


@pytest.mark.slow
def test_with_nine_poses_the_slip_is_named(tmp_path) -> None:
    station, folder = tmp_path / "station.yaml", tmp_path / "run"
    station.write_text(STATION.format(faults=SLIP))
    starbench("run", "nine_pose", "-s", station, "--seed", 7, "-o", folder, home=tmp_path / "home")
    run_results = results(folder)
    assert run_results["gimbal"]["verdict"] == SLIPPED
    slip = run_results["gimbal"]["slip"]
    assert (slip["axis"], slip["pose"]) == ("pan_deg", 4)
    assert slip["size_deg"] * 3600 == pytest.approx(17.5, abs=2)
    assert "pan axis slipped" in (folder / "report.html").read_text()
    assert max(abs(row["error_sigmas"]) for row in run_results["comparison"]) < 4
