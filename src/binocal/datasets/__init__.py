"""Pairs of images on disk: plain files paired by name, and data sets in their original layout with their calibration."""

from binocal.datasets.dataset import Dataset, StereoPair
from binocal.datasets.folder import ImagePair, Pairing, list_pairs
from binocal.datasets.opening import open_dataset

__all__ = ["Dataset", "ImagePair", "Pairing", "StereoPair", "list_pairs", "open_dataset"]
