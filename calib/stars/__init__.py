"""Images to stars: the tag, the grid of stars, their labels, and the centre of each star with its covariance."""
