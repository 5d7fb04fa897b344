"""Events to images: the flicker of the light, a window of whole periods, and one set of images for each recording."""
