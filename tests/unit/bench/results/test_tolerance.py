"""How far numbers that are calculated again may differ from the stored ones."""

from bench.results.compare_numbers import differences, tolerance


def results(fx, planar_fx, rms_px):
    return {
        "calibration": {"camera": {"fx": fx}, "sigma": {"fx": 1.0}, "rms_px": rms_px},
        "planar": {"camera": {"fx": planar_fx}, "sigma": {"fx": 40.0}, "rms_px": 0.3},
    }


def places(stored, derived):
    equal = tolerance(derived["calibration"]["sigma"], derived["planar"]["sigma"])
    return [one.where for one in differences(stored, derived, equal)]


def test_values_may_differ_by_a_thousandth_of_their_uncertainty_and_planar_ones_by_a_hundredth():
    derived = results(3345.0, 3300.0, 0.08)
    assert places(results(3345.0009, 3300.39, 0.08), derived) == []
    assert places(results(3345.0011, 3300.41, 0.08), derived) == ["calibration.camera.fx", "planar.camera.fx"]


def test_other_numbers_of_the_calibration_may_differ_by_a_millionth():
    derived = results(3345.0, 3300.0, 0.08)
    assert places(results(3345.0, 3300.0, 0.08000007), derived) == []
    assert places(results(3345.0, 3300.0, 0.0800001), derived) == ["calibration.rms_px"]
