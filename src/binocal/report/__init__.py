"""Results as figures: draws, never computes. Matplotlib stays in this room."""
