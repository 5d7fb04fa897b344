"""Station files and the devices they name; the station files that come along."""
