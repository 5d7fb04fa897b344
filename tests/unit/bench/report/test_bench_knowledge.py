"""What the report says about the collimator's passport, the gimbal's readings and the input files."""

from bench.report.html import ReportData, render_report
from bench.report.run_tables import inputs, passport_rows, readings_rows, source_rows
from tests.support.printed_text import printed_text


def test_the_report_names_the_passport_with_values_and_hash(data):
    rows = dict(inputs(data.results))
    assert rows["Collimator passport"] == (
        "number T-2041, of the collimator C-17, dated 2026-02-11, valid until 2028-02-11, at 20 °C, "
        "stated in the station file (certificate)"
    )
    assert rows["Values of the passport"] == "r = 255.03 mm, standard uncertainty 0.05 mm"
    text = printed_text(render_report(data, draw=False))
    assert "ab" * 32 in text
    assert "compared with the result only. The station does not bound the parallax." in text


def test_a_passport_from_views_lists_its_centre_and_names_its_aberrations(data):
    passport = data.results["passport"] | {
        "source": "sequence",
        "name": "c17.json",
        "number": None,
        "values": {"x": 96.1, "y": 140.2, "r": 255.0, "radial": 0.1},
        "sigma": {"x": 0.05, "y": 0.06, "r": 0.1, "radial": 0.01},
    }
    rows = dict(passport_rows(passport))
    assert rows["Collimator passport"].endswith("file named by the sequence (c17.json)")
    assert rows["Values of the passport"].endswith("r = 255 mm, standard uncertainty 0.1 mm; and radial")


def test_results_of_older_versions_have_no_such_rows(data):
    older = {k: v for k, v in data.results.items() if k not in ("passport", "gimbal_readings")}
    names = [name for name, _ in inputs(older)]
    assert not {"Collimator passport", "Gimbal readings"} & set(names)
    assert (passport_rows(None), readings_rows(None, None), source_rows([])) == ([], [], [])


def test_readings_that_entered_say_how_they_agree():
    readings = {"entered": True, "statement": None, "bound": None, "why_not": None}
    agreed = {
        "chi_square": 20.4,
        "degrees_of_freedom": 21,
        "rms_deg": 0.001,
        "scatter": 1.0,
        "reading_sigma_deg": 0.002,
    }
    ((_, text),) = readings_rows(readings, agreed)
    assert text == (
        "entered the adjustment as measurements; chi-square 20.4 with 21 degrees of freedom, 3.6 arc seconds RMS"
    )
    ((_, text),) = readings_rows(readings, agreed | {"scatter": 2.0, "reading_sigma_deg": 0.004})
    assert text.endswith(
        "entered with a standard uncertainty of 0.004°, because they scatter more than stated"
    )


def test_an_offline_report_says_so_and_lists_its_files(data):
    run = {
        "software": {},
        "id": "o1",
        "offline": True,
        "simulated": False,
        "calibrated_utc": "2026-03-01T12:00:00.000Z",
    }
    sources = [{"view": "left", "path": "a/<left>.csv", "size_bytes": 567, "sha256": "cd" * 32}]
    results = {"run": run, "calibration": data.results["calibration"], "sources": sources}
    html = render_report(ReportData(results), draw=False)
    text = printed_text(html)
    assert "OFFLINE: calibrated from existing files, without devices." in " ".join(text)
    assert {"a/<left>.csv", "cd" * 32, "567"} <= set(text)
    assert "Started" not in text
    assert not any("signature of this list" in line or "sealed" in line for line in text)
    assert any("no seal protects it" in line for line in text)
    assert not any("OFFLINE" in line for line in printed_text(render_report(data, draw=False)))
