"""Only `StoredRun` reads the journal of a run, replays it, and reads results.json."""

import re
from pathlib import Path

BENCH = Path(__file__).parents[4] / "bench"
READS = re.compile(
    r"read_journal\(|read_json\([^)]*\bRESULTS\)|\breplay\(read|read_bounded\([^)]*\bRESULTS\)"
)
OTHER_JOURNALS = {
    "record/stored_run.py", "record/journal.py",
    "record/ledger.py", "evidence/authorisations.py",  # the ledger, and signatures: chains of lines of their own
    "batch/batch_summary.py", "batch/batch_requests.py",  # the journal of a batch
    "extras/pages/panel/journal_tail.py",  # follows a journal that grows, line by line
    "record/run_facts.py",  # results.json is read only if its bytes are those that the journal names
    "extras/certificate/check.py", "extras/certificate/amend.py", "extras/certificate/issue.py",  # the copy of results.json in the folder of a certificate
}  # fmt: skip


def test_a_run_folder_is_read_in_one_place():
    lines = [
        f"{path.relative_to(BENCH)}: {line.strip()}"
        for path in sorted(BENCH.rglob("*.py"))
        if path.relative_to(BENCH).as_posix() not in OTHER_JOURNALS
        for line in path.read_text(encoding="utf-8").splitlines()
        if READS.search(line) and "def " not in line
    ]
    assert lines == []
