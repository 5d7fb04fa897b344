"""The engine in a world by a stranger's ray tracer (optiland, installed by hand): the true camera, and readings that enter."""

import pytest

from tests.benchmarks.worlds.catalogue import result as drawn_result

pytest.importorskip("optiland", reason="the ray tracer optiland is installed by hand: pip install optiland")


@pytest.mark.parametrize(("seed", "known"), [(9, "r"), (9, "0"), (32, "r")])
def test_a_closed_form_at_another_camera_does_not_mislead_and_right_readings_enter(seed, known):
    """Closed forms follow the errors of the collimator: fx was 1296 px wrong at U 204, and 8287 px at U 917."""
    line = drawn_result("stranger", 0, seed, known)
    assert abs(line["error"]["fx"]) < 1.3 * line["U"]["fx"] < 100.0
    assert not [note for note in line["notes"] if "did not enter" in note]


def test_a_right_certificate_is_not_refused_because_another_start_denies_it():
    """Three rolled poses before an eyepiece: from another start, the views alone show 319 mm; 577 mm is right."""
    line = drawn_result("stranger", 0, 511, "c")
    assert "refused" not in line
    assert abs(line["error"]["fx"]) < line["U"]["fx"] < 300.0


def test_a_hand_beside_a_right_certificate_accuses_neither_certificate_nor_ids():
    """25 poses: the views alone led 7 % away. From there residuals were 3.8 px, and 84 s were spent on shifted ids."""
    line = drawn_result("stranger", 0, 814, "c")
    assert not line["accused"]
    assert line["rms_px"] < 0.05
    assert abs(line["error"]["fx"]) < line["U"]["fx"]
    assert not [note for note in line["notes"] if "ids" in note]


def test_a_mirror_with_errors_finer_than_the_fields_moves_no_principal_point():
    """Its stars scatter 1.9 times as much as neighbours differ. When that counted as noise, cx was wrong by 60 px, 7 U."""
    line = drawn_result("stranger", 0, 2209, "r")
    assert abs(line["error"]["cx"]) < line["U"]["cx"] < 25.0
