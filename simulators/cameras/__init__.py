"""Simulated cameras that answer on TCP sockets: the EVK4 event camera and a frame camera."""
