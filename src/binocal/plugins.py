"""What other installed packages add to binocal, through entry points of theirs.

Looked up only for a name that is not built in, or where all names are listed: finding entry points takes milliseconds.
docs/extending.md shows one of each kind.
"""

from __future__ import annotations

from typing import Any

from binocal.errors import PluginError

CALIBRATORS = "binocal.calibrators"
FORMATS = "binocal.formats"
CAMERA_MODELS = "binocal.camera_models"

_loaded: dict[tuple[str, str], Any] = {}


def load_plugin(group: str, name: str, kind: type | None = None) -> Any:
    """What the entry point of that name is; None where no installed package has one.

    ``kind`` is the type that it must be of; None asks for something that can be called.

    Raises:
        PluginError: It cannot be imported, or is no such thing; the text names the package.
    """
    if (group, name) in _loaded:
        return _loaded[group, name]
    from importlib.metadata import entry_points

    found = entry_points(group=group, name=name)
    if not found:
        return None
    entry = next(iter(found))
    package = entry.dist.name if entry.dist is not None else entry.module
    try:
        value = entry.load()
    except Exception as error:  # whatever another package's module raises while it is imported
        raise PluginError(
            group, name, package, f"{entry.value} fails to load: {type(error).__name__}: {error}"
        ) from error
    if not (callable(value) if kind is None else isinstance(value, kind)):
        expected = "a function" if kind is None else f"a {kind.__name__}"
        raise PluginError(group, name, package, f"{entry.value} is a {type(value).__name__}, not {expected}")
    if kind is not None and value.name != name:
        raise PluginError(group, name, package, f"{entry.value} calls itself {value.name!r}; both names must be equal")
    _loaded[group, name] = value
    return value


def plugin_names(group: str) -> tuple[str, ...]:
    """The names that installed packages add, in alphabetical order; none of them is imported."""
    from importlib.metadata import entry_points

    return tuple(sorted({entry.name for entry in entry_points(group=group)}))
