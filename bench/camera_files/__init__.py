"""Calibrated cameras from files: results of a run, and the files of seven other programs, each read strictly."""
