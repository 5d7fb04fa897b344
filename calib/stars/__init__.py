"""Images to stars: the tag, the grid, the label and the centre of each star with its covariance."""
