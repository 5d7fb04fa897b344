"""Pages in a browser: alignment with the devices of a station, and the panel of runs and batches without devices."""
