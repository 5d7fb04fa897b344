"""Station files, the devices that they name, and the shipped station files."""
