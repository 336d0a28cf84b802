"""Image files: strict reading, grey levels and bit depth, checks of the container, PNG writing."""

from binocal.images.reading import CHANNELS, read_grey_image, read_image, to_grey

__all__ = ["CHANNELS", "read_grey_image", "read_image", "to_grey"]
