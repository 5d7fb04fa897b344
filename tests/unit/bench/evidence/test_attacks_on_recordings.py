"""Changes that are consistent in all other files: only the recordings tell, by `verify --again`."""

import pytest

from bench.again.run import check_run_again
from tests.unit.bench.evidence.attack_steps import (
    CAPTURE,
    checked,
    forged_focal_length,
    in_views,
    move_star,
    other_truth,
    paint,
    rederive,
    result,
    swap_captures,
)

pytestmark = pytest.mark.usefixtures("made_once")


def test_the_untouched_run_is_valid_and_follows_from_its_recordings(run_once, trusted):
    verification = checked(run_once, trusted)
    assert (verification.faults, verification.not_compared) == ([], [])
    assert verification.complete
    assert verification.state == "SEALED"
    assert any("last bit" in remark for remark in verification.remarks)


QUICK = ("focal length in every file", "image painted over")


def other_gate(f):
    f.edit_line("attempt_checked", lambda d: d["gates"][0].update(value=999))
    f.edit_results(lambda r: r["gates"][0].update(value=999))


AGAIN = {
    "focal length in every file": (forged_focal_length, "results.json"),
    "stars moved in the views": (in_views(move_star), "views.h5"),
    "image painted over": (paint, "views.h5"),
    "truth of the simulated world": (other_truth, "results.json"),
    "witnesses removed": (result("calibration", "witnesses", to=[]), "results.json"),
    "gate of a recording in journal and results": (other_gate, "journal.jsonl"),
    "recordings exchanged, every hash put right": (swap_captures, "journal.jsonl"),
}


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in AGAIN]
)
def test_what_is_consistent_in_all_other_files_is_found_from_the_recordings(forger, trusted, job, name):
    """Whoever has key and program can write all other files again."""
    attack, where = AGAIN[name]
    attack(forger)
    rederive(forger, job)
    forger.seal()
    plain = checked(forger.folder, trusted, again=False)
    assert (plain.faults, plain.again) == ([], False)
    verification = checked(forger.folder, trusted)
    assert where in {fault.where for fault in verification.faults}, verification.to_dict()


@pytest.mark.slow
def test_a_recording_without_stars_is_told_in_words(forger):
    (forger / (CAPTURE % 2)).write_bytes(b"% nothing\n")
    faults = [str(fault) for fault in check_run_again(forger.folder).faults]
    assert any("cannot be calibrated again" in fault for fault in faults), faults
