"""Devices by description: text protocols that a file describes, without code. Opens nothing and reads no file."""
