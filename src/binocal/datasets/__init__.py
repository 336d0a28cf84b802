"""Pairs of images on disk: which files there are, and which left one belongs to which right one."""

from binocal.datasets.folder import Pairing, PicturePair, list_pairs

__all__ = ["Pairing", "PicturePair", "list_pairs"]
