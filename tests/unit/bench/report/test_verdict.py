"""What a report says first: the verdict, the worst corner, the stars' support, the change since the last calibration."""

import re
from dataclasses import replace

from bench.report.html import render_report
from bench.report.verdict import change, verdict
from calib.model.cause import FOCUSED, Cause, cause_sentence


def verdict_with(data, **more):
    return verdict({**data.results, "gates": [], "failures": [], "deviations": [], **more})


def test_a_good_result_says_so_with_its_worst_corner_and_its_factor(data):
    judged = verdict_with(data)
    assert (judged.kind, judged.headline, judged.reasons) == ("pass", "Calibrated.", ())
    facts = (
        r"3346\.4 ± 4\.3 px, .* 3346\.7 ± 4\.3 px \(k = 2",
        r"71 µrad = 0\.25 px .* \(top left\).* 33 µrad = 0\.11 px",
        r"87 % .* 53 µrad = 0\.19 px",
        r"three_pose-20260225-090000, 4 days .* 0\.061 px",
    )
    assert [bool(re.search(*each)) for each in zip(facts, judged.sentences, strict=True)] == [True] * 4


def test_gates_that_fail_and_reservations_change_it(data):
    gate = {"name": "rms", "value": 0.31, "unit": "px", "limit": "<= 0.2", "verdict": "fail"}
    good = {**gate, "name": "mean", "verdict": "pass"}
    judged = verdict_with(data, gates=[gate, good])
    assert (judged.kind, judged.headline) == ("fail", "Calibrated, but 1 of 2 gates fails.")
    assert judged.reasons[0].startswith("Gate rms: fail")
    judged = verdict_with(data, deviations=["Pose 2 was skipped."])
    assert (judged.kind, judged.headline) == ("marginal", "Calibrated, with reservations.")
    assert judged.reasons == ("Pose 2 was skipped.",)
    assert judged.line == "Calibrated, with reservations. Pose 2 was skipped."


def test_a_note_that_doubts_the_values_is_on_the_first_screen_and_a_pause_is_not(data, results):
    results |= {"holds": ["Held by ada@lab for 24 s before step 26."]}
    doubt, remark = "Views differ 3.5 times more than star noise explains.", "The radial model predicts best."
    results["calibration"] |= {"notes": [doubt, remark], "remarks": [remark]}
    judged = verdict_with(type(data)(results))
    assert (judged.kind, judged.reasons) == ("marginal", (doubt,))
    results["calibration"]["notes"] = [remark]
    assert verdict_with(type(data)(results)).kind == "pass"
    page = render_report(type(data)(results))
    assert "<h3>Pauses</h3>" in page
    assert "Held by ada@lab" in page


def test_without_convergence_no_value_is_stated(data, results):
    results["calibration"]["converged"] = False
    judged = verdict(results)
    assert (judged.kind, judged.headline) == ("fail", "Not calibrated.")
    assert judged.sentences == ("The optimisation did not converge: do not use the values.",)
    assert judged.sentences[0] in render_report(type(data)(results))


def test_results_of_earlier_versions_still_name_a_worst_corner(data):
    results = {key: value for key, value in data.results.items() if key not in ("projection", "previous")}
    worst = "Error of an image point in the worst corner: at most 0.9"
    assert any(sentence.startswith(worst) for sentence in verdict(results).sentences)
    assert change(results) is None
    first = {"run": None, "why_not": "This is the first calibration of this camera on this bench."}
    assert verdict_with(data, previous=first).sentences[-1] == first["why_not"]


def test_a_change_beyond_its_uncertainty_is_told_with_its_size(results):
    change_then = results["previous"]["change"]
    results["previous"]["change"] = replace(change_then, largest_ratio=2.4, px_there=0.31, largest_px=0.44)
    results["previous"]["calibration"]["camera"]["fx"] -= 20
    change_text = ": changed by up to 0.31 px = 2.4 U at one place; largest change 0.44 px."
    assert verdict(results).sentences[-1].endswith(change_text)
    (fx, *others) = change(results).rows
    assert (fx["name"], fx["change"]) == ("fx", ("21.5", "6.0"))  # U = hypot(4.26, 4.26)
    assert (fx["normalised"], fx["verdict"]) == ("3.57", "marginal")
    assert {row["normalised"] for row in others} == {"0.00"}


def test_what_a_person_did_stands_first_once_and_a_right_result_is_not_called_good(data, results):
    cause = Cause(FOCUSED, 80.0, 0.14, 0.002, "%", before="left", pose="right")
    sentence = cause_sentence(cause)
    results |= {"causes": [cause.to_dict()]}
    results["calibration"] |= {"notes": [sentence]}
    judged = verdict_with(type(data)(results))
    assert (judged.kind, judged.headline) == ("marginal", "Calibrated, with reservations.")
    assert (judged.causes, judged.reasons) == ((sentence,), ())
    page = render_report(type(data)(results))
    assert page.index("0.1400 ± 0.0020 % (k = 2) longer") < page.index("4.3 px")
