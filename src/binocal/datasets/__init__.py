"""Pictures on disk: reading them strictly, and pairing left with right by name."""

from binocal.datasets.folder import Pairing, PicturePair, list_pairs
from binocal.datasets.pictures import read_grey_picture, read_picture, to_grey

__all__ = ["Pairing", "PicturePair", "list_pairs", "read_grey_picture", "read_picture", "to_grey"]
