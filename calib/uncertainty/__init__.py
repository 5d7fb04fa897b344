"""Uncertainty of an adjustment: covariance, variance components, cross-validation, consistency, projection."""
