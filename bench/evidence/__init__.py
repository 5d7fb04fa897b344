"""Seals of run folders: signatures, keys, and their verification."""
