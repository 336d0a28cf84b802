"""Results as figures: draws, never computes. Matplotlib is imported here alone."""
