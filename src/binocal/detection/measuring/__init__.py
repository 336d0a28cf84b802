"""Where a board's points are in an image, to a hundredth of a pixel, each with its covariance."""
