"""The reticle of a station: its drawing in several file formats, and what it is good for. No devices."""
