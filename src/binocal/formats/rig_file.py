"""A rig from whatever file holds one, recognised by its content."""

from __future__ import annotations

from pathlib import Path

from binocal.cameras import StereoRig
from binocal.errors import FormatError
from binocal.formats import opencv_yaml, rig_json
from binocal.formats.detections_npz import is_detections_file
from binocal.formats.registry import find_format


def load_rig(path: str | Path) -> StereoRig:
    """The rig of a file of any known format.

    ``rig.json``, ``truth.json``, OpenCV's files (YAML, XML or JSON; two files: name either), and what installed packages add.

    Raises:
        FormatError: The file is none of these, or a value in it is not what it should be.
        PluginError: An added format fails to load.
    """
    path = Path(path)
    found = find_format(path)
    if found is not None:
        return found.read(path)
    if is_detections_file(path):
        raise FormatError(path, "holds corners, not a rig; name the rig.json that was calibrated from them")
    # nobody knows it: the reader that its name suggests says what is wrong
    return rig_json.read_rig(path) if path.suffix.lower() == ".json" else opencv_yaml.read_opencv(path)
