"""The records of runs on the disk: journal, run folder, captures, index of runs, ledger, inbox."""
