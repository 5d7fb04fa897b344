"""Control charts over the runs of each camera, the drift they show, and the check standard of a station."""
