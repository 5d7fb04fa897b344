"""Generators and controllers that drive the lamp, the lamp, its sync line."""
