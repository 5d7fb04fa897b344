"""Drivers that other packages bring: entry points whose sections are loaded, and join the built-in ones."""

from __future__ import annotations
