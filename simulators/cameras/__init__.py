"""Cameras on sockets."""
