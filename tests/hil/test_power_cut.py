"""The power goes while a run writes: what was acknowledged is there, what is there is whole, and the run goes on.

A file system of our own (ext4 in a file) is shut down by the kernel in the midst of writing, without its log being
flushed, as a cut of power does; then it is mounted again. Needs root, mkfs.ext4 and loop devices. Two ways:
*frozen*, the writer is stopped first, so that every acknowledgement is known (durability); *running*, the cut
falls into a sync (consistency; an acknowledgement given while the cut happens may be a false one).
"""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from waiting import wait_until

from bench.base.clock import BenchClock
from bench.record.journal import Journal, read_journal, stored_captures
from bench.record.recovery import recover
from bench.record.run_folder import RunFolder

WRITER = """
import hashlib, sys
from pathlib import Path
from bench.base.clock import BenchClock
from bench.record.journal import Journal
from bench.record.journal import CAPTURE_STORED, capture_name
from bench.record.recovery import recover
from bench.record.run_folder import RunFolder
path = Path(sys.argv[1])
NOTES = 5
begun = (path / "journal.jsonl").exists()
folder = RunFolder.open(path) if begun else RunFolder.create(path)
journal = (Journal.open if begun else Journal.create)(folder.journal_path, BenchClock())
if begun:
    recover(folder, journal)
pose = sum(e.event == CAPTURE_STORED for e in journal.entries)
print("ready", flush=True)
while True:
    pose += 1
    folder.part_path(capture_name(pose, 1)).write_bytes(hashlib.sha256(str(pose).encode()).digest() * 300)
    capture = folder.commit(capture_name(pose, 1))
    for number in range(NOTES):  # lines that last with the next one that counts
        journal.put("on_the_way", {"number": number, "text": "x" * 900}, synced=False)
    journal.append(CAPTURE_STORED, pose=pose, attempt=1, **capture.as_data())
    print(pose, flush=True)
    for number in range(NOTES):
        journal.put("on_the_way", {"number": number, "text": "y" * 900}, synced=False)
"""


def write_until_cut(disk, path, *, frozen, after_s):
    """Let a process write poses, cut the power, and return the number of the last one acknowledged."""
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, path], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as writer:
        assert writer.stdout.readline() == "ready\n"
        time.sleep(after_s)
        if frozen:
            writer.send_signal(signal.SIGSTOP)
            wait_until(lambda: ") T " in Path(f"/proc/{writer.pid}/stat").read_text(), 60.0)
        disk.cut_power()
        writer.send_signal(signal.SIGKILL)
        acknowledged = writer.stdout.read().splitlines()
    disk.mount_again()
    whole = [int(word) for word in acknowledged]
    return whole[-1] if whole else 0


def poses_on_disk(path):
    """Poses that the journal tells of, each seen to be whole."""
    entries, _ = read_journal(path / "journal.jsonl")
    captures = stored_captures(entries)
    with RunFolder.open(path) as folder, Journal.open(folder.journal_path, BenchClock()) as journal:
        notes = recover(folder, journal)
    assert (notes["missing"], notes["changed"]) == ([], [])
    assert len(notes["intact"]) == len(captures)
    assert {p.name for p in (path / "captures").iterdir()} == {Path(name).name for name in captures}
    return len(captures)


@pytest.mark.slow
@pytest.mark.parametrize("frozen", [True, False], ids=["frozen", "running"])
def test_nothing_acknowledged_is_lost_and_what_is_there_is_whole_when_the_power_goes(disk, frozen):
    moments = random.Random(1)
    path, cuts, kept = disk.mounted / "run", 25, 0
    for _ in range(cuts):
        last = write_until_cut(disk, path, frozen=frozen, after_s=moments.uniform(0.02, 0.4))
        on_disk = poses_on_disk(path)
        assert on_disk >= kept
        assert on_disk >= last or not frozen
        kept = on_disk
    assert kept > 0
