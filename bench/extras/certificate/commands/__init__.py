"""The group of commands `certificate`."""
