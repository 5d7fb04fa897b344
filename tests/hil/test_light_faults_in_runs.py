"""Faults of the light that its driver cannot know, in whole runs: each is told by the recordings, for its own reason."""

from __future__ import annotations

from pathlib import Path

import pytest
from running import journal, starbench
from station_texts import PLAIN

SEQUENCES = Path(__file__).parents[2] / "sequences"

REFUSED = {
    "lamp_open": "view left: Tag 3",
    "wrong_frequency factor=0.98": "flicker off nominal",
    "wrong_frequency factor=2": "triggers: The triggers come at 120",
    "wrong_duty factor=0.4": "flicker duty",
    "no_sync": "no sync triggers",
    "sync_inverted": "events after sync",
    "sync_missing factor=2": "triggers: The triggers come at 30",
    "sync_extra factor=2": "triggers missed",
    "sync_jitter factor=0.2": "flicker",
    "trip": "view",
}
"""By the order: what one of the reasons begins with."""


def run(tmp_path: Path, order: str) -> tuple[int, list[dict], str]:
    fault, *parameters = order.split()
    words = ", ".join([f"fault: {fault}", *(p.replace("=", ": ") for p in parameters)])
    station, folder = tmp_path / "station.yaml", tmp_path / "run"
    after = ", after_s: 6" if fault == "trip" else ""
    station.write_text(
        PLAIN.replace("simulation: {}\n", f"simulation: {{faults: [{{device: light, {words}{after}}}]}}\n")
    )
    sequence = tmp_path / "sequence.yaml"
    text = (SEQUENCES / "three_pose.yaml").read_text(encoding="utf-8")
    assert "attempts: 2}" in text
    # A sync output may be even whatever the duty of the light, so that no duty is demanded unless a sequence does.
    sequence.write_text(text.replace("attempts: 2}", "attempts: 2, gates: {min_flicker_duty: 0.4}}"))
    said = starbench("run", sequence, "-s", station, "--seed", 7, "-o", folder, home=tmp_path / "home")
    return said.returncode, [x for x in journal(folder) if x["event"] == "attempt_checked"], said.stderr


@pytest.mark.slow
@pytest.mark.parametrize("order", REFUSED)
def test_a_light_that_is_not_what_it_says_is_never_calibrated_from(tmp_path, order) -> None:
    status, checked, said = run(tmp_path, order)
    print(f"\n{order}: {status}: {[x['reasons'] for x in checked]}: {said.strip().splitlines()[-1]}")
    assert status == 1
    assert "Traceback" not in said
    reasons = [reason for x in checked for reason in x["reasons"]]
    assert any(reason.startswith(REFUSED[order]) for reason in reasons)
