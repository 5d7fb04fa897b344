"""What is true at any time: where axes point, what the light does, how warm it is."""
