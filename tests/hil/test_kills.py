"""SIGKILL at random moments: whatever the moment, the resumed run ends as the undisturbed one. Slow."""

import os
import random
import time

import pytest
from running import end_at, journal, numbers, starbench, start

KILLS = int(os.environ.get("STARBENCH_KILLS", "50"))
SEED = 7


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_a_run_killed_at_random_moments_loses_nothing_doubles_nothing_and_ends_the_same(tmp_path):
    home, whole = tmp_path / "home", tmp_path / "undisturbed"
    began = time.monotonic()
    assert (
        starbench("run", "three_pose", "-s", "simulated", "--seed", SEED, "-o", whole, home=home).returncode
        == 0
    )
    length_s = time.monotonic() - began
    chance = random.Random(1)
    told: list[str] = []
    folder, number = tmp_path / "killed-0", 0
    process = start("run", "three_pose", "-s", "simulated", "--seed", SEED, "-o", folder, home=home)
    kills = 0
    while kills < KILLS:
        died = end_at(process, chance.uniform(0.2, 0.9 * length_s))
        kills += died
        lines = journal(folder)
        told.append(lines[-1]["event"] + " " + lines[-1].get("state", "") if lines else "before the journal")
        if lines and not (folder / "SHA256SUMS.sig").exists():
            process = start("resume", folder, home=home)
            continue
        if lines:
            check(folder, whole)
        number += 1
        folder = tmp_path / f"killed-{number}"
        process = start("run", "three_pose", "-s", "simulated", "--seed", SEED, "-o", folder, home=home)
    process.communicate(timeout=240)
    if (folder / "journal.jsonl").exists() and not (folder / "SHA256SUMS.sig").exists():
        assert starbench("resume", folder, home=home).returncode == 0
    check(folder, whole)
    print(f"\n{kills} kills over {number + 1} runs, after: {sorted(set(told))}")


def check(folder, whole):
    """Each pose stored and accepted once or, where the kill fell between storing and telling, set aside and made again."""
    lines = journal(folder)
    stored = [(line["pose"], line["attempt"]) for line in lines if line["event"] == "capture_stored"]
    accepted = [line["pose"] for line in lines if line["event"] == "attempt_checked" and line["accepted"]]
    assert sorted(accepted) == [1, 2, 3]
    assert len(stored) == len(set(stored)) == 3
    assert numbers(folder) == numbers(whole)
