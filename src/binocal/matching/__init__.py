"""Image pairs to matches of points: features, their descriptors, and windows fitted to a hundredth of a pixel."""
