"""Changes of a sealed run that are sealed again with the bench's own key: which check finds each?

    python tests/benchmarks/bench_resealed.py [--write]

Whoever changes a file also puts right every hash and file that follows from it, as far as the change says. A run of the
simulated bench is made once and copied for each change.
"""

import logging
import sys
import tempfile
from pathlib import Path

import measured

from bench.evidence.keys import load_key
from bench.evidence.ledger_check import ledger_faults_of_run
from bench.evidence.signers import read_signers
from bench.plan.job import Job
from bench.record.ledger import Ledger
from tests.unit.bench.evidence.attack_steps import checked, rederive
from tests.unit.bench.evidence.attacked_run import kept_in_memory, make_run
from tests.unit.bench.evidence.resealed import Forger, copied
from tests.unit.bench.evidence.test_attacks import ATTACKS
from tests.unit.bench.evidence.test_attacks_on_recordings import AGAIN, ONLY_A_NEW_RECORDING

UNSEEN = "only a new recording could tell"


def main() -> int:
    """Print for each check the changes that it is the first to find; return 1 if an expected one is missed."""
    changes = {attack.name: lambda forger, _job, do=attack.do: do(forger) for attack in ATTACKS}
    changes |= {
        name: lambda forger, job, do=attack: (do(forger), rederive(forger, job))
        for name, (attack, _where) in AGAIN.items()
    }
    changes |= ONLY_A_NEW_RECORDING
    changes_of: dict[str, list[str]] = {"`verify`": [], "`verify --again` only": [], UNSEEN: []}
    by_ledger = 0
    with tempfile.TemporaryDirectory() as place, kept_in_memory():
        home, folder = Path(place, "home"), Path(place, "made")
        folder.mkdir()
        run = make_run(folder, home)
        key, trusted = load_key(home), read_signers(home / "allowed_signers")
        job = Job.from_run_folder(run, seed=1, operator="Ada")
        ledger = Ledger(home, None)
        for number, (name, attack) in enumerate(changes.items()):
            forger = Forger(copied(run, Path(place, str(number))), key)
            attack(forger, job)
            forger.seal()
            plain, again = checked(forger.folder, trusted, again=False), checked(forger.folder, trusted)
            column = 0 if plain.faults else 1 if again.faults else 2
            list(changes_of.values())[column].append(name)
            by_ledger += bool(ledger_faults_of_run(forger.folder, ledger))
    print("| found by | changes |\n| --- | --- |")
    for column, names in changes_of.items():
        print(f"{column}: {'; '.join(names)}", file=sys.stderr)
        print(f"| {column} | {len(names)} |")
    print(f"| the ledger of the bench that made the run | {by_ledger} |")
    return set(changes_of[UNSEEN]) != set(ONLY_A_NEW_RECORDING)


if __name__ == "__main__":
    logging.disable()
    measured.run(main, "evidence", "Changes sealed again with the bench's own key")
