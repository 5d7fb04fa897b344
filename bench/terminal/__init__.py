"""The terminal: progress, questions, signals, and what the terminal can show. Imports the base only."""
