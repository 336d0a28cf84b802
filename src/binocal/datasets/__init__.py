"""Pairs of images on disk: which files there are, and which left one belongs to which right one."""

from binocal.datasets.folder import ImagePair, Pairing, list_pairs

__all__ = ["ImagePair", "Pairing", "list_pairs"]
