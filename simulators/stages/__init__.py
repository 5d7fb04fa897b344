"""Motor controllers, and the axes they turn."""
