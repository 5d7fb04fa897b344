"""What a run leaves on the disk, and how it gets there whole: journal, folder, captures, index, ledger."""
