"""Calibration certificates by ISO/IEC 17025 from sealed runs: data, PDF, digital certificate, series of numbers."""
