"""The joint solver: residuals, robust losses, least squares, covariance, board poses."""
