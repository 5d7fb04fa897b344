"""The terminal: progress, questions to the operator, signals, text encodings. Imports `bench.base` only."""
