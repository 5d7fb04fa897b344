"""Recordings to views: measuring a recording, the quality gates, the two kinds of cameras, `views.h5`."""
