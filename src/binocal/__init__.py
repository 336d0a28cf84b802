"""binocal: stereo-camera calibration that measures depth and says how far the depth can be trusted."""

__version__ = "0.1.0"
