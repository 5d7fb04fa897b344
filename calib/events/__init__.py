"""Events to images: the flicker of the light, whole periods of it, and one image a recording."""
