"""The file formats of rigs by name: binocal's own, OpenCV's, and those that installed packages add."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from binocal import plugins
from binocal.formats.base import Format


def _binocal() -> Format:
    from binocal.formats import rig_json

    return Format(
        "binocal",
        "rig.json and truth.json of binocal",
        (".json",),
        rig_json.is_rig_file,
        rig_json.read_rig,
        rig_json.write_rig,
        lambda rig: (),
    )


def _opencv() -> Format:
    from binocal.formats import opencv_yaml

    return Format(
        "opencv",
        "OpenCV's FileStorage: YAML, XML or JSON, one file or intrinsics and extrinsics",
        (".yml", ".yaml", ".xml", ".json"),
        opencv_yaml.is_opencv_file,
        opencv_yaml.read_opencv,
        opencv_yaml.write_opencv,
        opencv_yaml.opencv_losses,
    )


FORMATS: dict[str, Callable[[], Format]] = {"binocal": _binocal, "opencv": _opencv}
"""The built-in formats, in the order in which a file is tried."""


def load_format(name: str) -> Format:
    """The format of that name.

    Raises:
        ValueError: No such format; the text names those that are known.
        PluginError: An installed package adds it, and it fails to load.
    """
    if name in FORMATS:
        return FORMATS[name]()
    added = plugins.load_plugin(plugins.FORMATS, name, Format)
    if added is None:
        raise ValueError(f"unknown format {name!r}; known: {', '.join(known_formats())}")
    return added


def known_formats() -> tuple[str, ...]:
    """Names of all formats, the built-in ones first."""
    return (*FORMATS, *(name for name in plugins.plugin_names(plugins.FORMATS) if name not in FORMATS))


def find_format(path: str | Path) -> Format | None:
    """The format of a file by its content; formats that packages add are tried where no built-in one knows it."""
    path = Path(path)
    for make in FORMATS.values():
        if (built_in := make()).probe(path):
            return built_in
    for name in known_formats()[len(FORMATS) :]:
        if (added := load_format(name)).probe(path):
            return added
    return None
