"""Seals, signatures, keys, and what verifies them."""
