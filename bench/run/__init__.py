"""One run: its states and their work; beginning, holding, stopping and resuming a run."""
