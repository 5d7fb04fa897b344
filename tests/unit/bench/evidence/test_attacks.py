"""A sealed run that somebody with the bench's own key has changed and sealed again: each change is found.

`ssh-keygen` and `sha256sum` accept every one of these folders.
"""

from dataclasses import dataclass

import pytest
from slow_cases import slow

from calib.model.cause import Cause
from tests.unit.bench.evidence.attack_steps import (
    CAPTURE,
    a_cause,
    checked,
    drop,
    edit,
    in_views,
    line,
    other_serial,
    remove,
    result,
    shifted_clock,
    with_hashes,
    without_pose,
    without_program,
    without_results,
    write,
)
from tests.unit.bench.evidence.resealed import kinds

pytestmark = pytest.mark.usefixtures("made_once")


@dataclass(frozen=True)
class Attack:
    """One attack: its name, what it does, and where it is found."""

    name: str
    do: object
    where: str
    kind: str


ATTACKS = [
    # documents
    Attack("station edited", edit("station.yaml", "laboratory: ", "laboratory: Other "), "station.yaml", "plan"),
    slow(Attack("station's name, told", with_hashes(edit("station.yaml", "name: ", "name: My ")), "journal.jsonl:1", "journal")),
    Attack("pose added to the sequence, told", with_hashes(edit("sequence.yaml", "tilt_deg: -3}", "tilt_deg: -3}, {name: more, pan_deg: 1}")), "journal.jsonl", "journal"),
    Attack("passport removed", remove("passport.json"), "passport.json", "plan"),
    Attack("passport removed, told", with_hashes(remove("passport.json")), "station.yaml", "plan"),
    slow(Attack("plan edited, told", with_hashes(edit("plan.json", '"size_bytes": ', '"size_bytes": 1')), "plan.json", "plan")),
    # journal
    Attack("journal edited", edit("journal.jsonl", '"operator":"Ada"', '"operator":"Eve"'), "journal.jsonl:1", "journal"),
    Attack("operator in the journal", line("run_started", lambda d: d.update(operator="Eve")), "results.json", "results"),
    Attack("not simulated, in the journal", line("run_started", lambda d: d.update(simulated=False)), "journal.jsonl:1", "journal"),
    Attack("verdict of a gate", line("attempt_checked", lambda d: d["gates"][1].update(verdict="fail")), "results.json", "results"),
    slow(Attack("angle of a pose", line("capture_stored", lambda d: d["measured_deg"].update(pan=-6.1)), "journal.jsonl", "journal")),
    Attack("numbers of the journal's calibration", line("solved", lambda d: d["values"].update(fx=1670.0)), "journal.jsonl", "journal"),
    Attack("verdict of the report", line("written", lambda d: d["verdict"].update(kind="fail")), "journal.jsonl", "journal"),
    Attack("no verdict in the journal", line("written", lambda d: d.pop("verdict")), "journal.jsonl", "journal"),
    Attack("a cause in journal and results", a_cause, "journal.jsonl", "journal"),
    Attack("first line removed", drop("run_started"), "journal.jsonl:1", "journal"),
    Attack("last line removed", drop("run_ended"), "journal.jsonl", "journal"),
    Attack("run not finished", line("run_ended", lambda d: d.update(how="aborted")), "journal.jsonl", "journal"),
    Attack("hashes of the results removed", drop("written"), "journal.jsonl", "journal"),
    Attack("hashes of the results removed, and the program that wrote them", without_program, "journal.jsonl", "journal"),
    Attack("clock moved within the run", shifted_clock, "journal.jsonl:21", "journal"),
    slow(Attack("a pose never happened", without_pose, "journal.jsonl", "journal")),
    Attack("a second begin", with_hashes(lambda f: f.chain([*f.lines[:5], f.lines[0], *f.lines[5:]])), "journal.jsonl:6", "journal"),
    # results
    Attack("results edited", edit("results.json", '"operator": "Ada"', '"operator": "Eve"'), "results.json", "results"),
    Attack("results without the journal's recordings", result("poses", 1, "attempts", to=[]), "results.json", "results"),
    Attack("camera serial", result("devices", "camera", "serial", to="00050999"), "results.json", "results"),
    Attack("results removed", remove("results.json"), "results.json", "results"),
    Attack("results never written", without_results, "journal.jsonl", "journal"),
    # views
    Attack("residual of a star", in_views(lambda h: h["pose-001/residuals_px"].__setitem__(0, (9.0, 9.0))), "views.h5", "views"),
    Attack("hidden data in the views", in_views(lambda h: h.create_dataset("secret", data=[1])), "views.h5", "views"),
    Attack("hidden bytes after the views", with_hashes(lambda f: f.replace("views.h5", (f / "views.h5").read_bytes(), (f / "views.h5").read_bytes() + b"x")), "views.h5", "views"),
    # exports
    Attack("export edited, told", with_hashes(edit("exports/opencv.yaml", "167", "168")), "exports/opencv.yaml", "exports"),
    # recordings
    Attack("recording exchanged", write(CAPTURE % 2, b"% end\n"), CAPTURE % 2, "recording"),
    Attack("recording removed", remove(CAPTURE % 2), CAPTURE % 2, "recording"),
    Attack("recording added", write("captures/pose-004-attempt-1.raw", b"% end\n"), "captures/pose-004-attempt-1.raw", "recording"),
    Attack("another camera, everywhere but in the files", other_serial, CAPTURE % 1, "recording"),
    # kind and seal
    Attack("a run as a certificate", write("certificate.json", b"{}\n"), "certificate.json", "kind"),
    Attack("a run as recalculated results", lambda f: [remove("journal.jsonl")(f), write("sources.json", b'{"sources": []}\n')(f)], CAPTURE % 1, "kind"),
]  # fmt: skip


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_a_resealed_change_is_found(forger, trusted, attack):
    attack.do(forger)
    forger.seal()
    verification = checked(forger.folder, trusted)
    found = {fault.kind for fault in verification.faults}
    assert not {"signature", "key", "changed", "added", "missing"} & found
    assert (attack.kind, attack.where) in kinds(verification), [str(fault) for fault in verification.faults]


def test_the_journal_may_tell_what_rests_on_an_earlier_run_and_results_may_not(forger, trusted):
    told = Cause("light set otherwise", 20.0, 40.0, unit="%", stated=50.0, axis="duty", before="run-7")
    line("solved", lambda data: data["causes"].append(told.to_dict()))(forger)
    forger.seal()
    assert checked(forger.folder, trusted).ok
    with_hashes(lambda f: f.edit_results(lambda results: results["causes"].append(told)))(forger)
    forger.seal()
    assert ("journal", "journal.jsonl") in kinds(checked(forger.folder, trusted))
