"""Runs and nights on a virtual clock."""
