"""A rig from whatever file holds one, recognised by its content."""

from __future__ import annotations

from pathlib import Path

from binocal.cameras import StereoRig
from binocal.errors import FormatError
from binocal.formats import opencv_yaml, rig_json


def load_rig(path: str | Path) -> StereoRig:
    """The rig of a ``rig.json``, a ``truth.json``, or OpenCV's files (YAML, XML or JSON; two files: name either).

    Raises:
        FormatError: The file is none of these, or a value in it is not what it should be.
    """
    path = Path(path)
    if path.suffix.lower() != ".json":
        return opencv_yaml.read_opencv(path)
    try:
        return rig_json.read_rig(path)
    except FormatError as not_ours:
        try:
            return opencv_yaml.read_opencv(path)
        except FormatError:
            raise not_ours from None
