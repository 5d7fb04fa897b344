"""What the camera would see: target, collimator, lens, screen."""
