"""The sensor: pixels, readout, filters on the chip, words on the wire."""
