"""Makes the environment known to Gymnasium, whichever of the two packages is imported first.

Gymnasium 1 loads no plugins: an environment exists for it once the package that registers it was imported. Importing
``binocal`` must not load Gymnasium, so where that is not loaded yet, registering waits for its import.
"""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

ENV_ID = "binocal/StereoExtrinsics-v0"


def register() -> None:
    """Registers ``binocal/StereoExtrinsics-v0``, both forms; a second call changes nothing. Loads Gymnasium."""
    import gymnasium

    from binocal.rl.task import MAX_STEPS

    if ENV_ID not in gymnasium.registry:
        gymnasium.register(
            ENV_ID,
            entry_point="binocal.rl.env:StereoExtrinsicsEnv",
            vector_entry_point="binocal.rl.env:StereoExtrinsicsVectorEnv",
            max_episode_steps=MAX_STEPS,
        )


def register_with_gymnasium() -> None:
    """Registers now if Gymnasium is loaded, else as soon as it is."""
    if "gymnasium" in sys.modules:
        register()
    else:
        sys.meta_path.insert(0, _AfterGymnasium())


class _AfterGymnasium(MetaPathFinder):
    """Finds Gymnasium as the other finders do, and registers after it was loaded. Everything else it leaves to them."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        spec = next(filter(None, (finder.find_spec(fullname, path, target) for finder in others)), None)
        if spec is None or spec.loader is None:
            return spec
        load = spec.loader.exec_module

        def load_and_register(module: ModuleType) -> None:
            load(module)
            if self in sys.meta_path:
                sys.meta_path.remove(self)
            register()

        spec.loader.exec_module = load_and_register
        return spec
