"""The application: what an operator runs. May import every other folder; none imports it."""

__version__ = "0.1.0"
