"""Makes the environment known to Gymnasium, without loading it.

Gymnasium 1 loads no plug-ins: ``gymnasium.make("binocal:binocal/StereoExtrinsics-v0")`` imports ``binocal`` and then looks in its
registry. Importing ``binocal`` must not load Gymnasium, so it registers only where Gymnasium is loaded already, which is so within
``make``; ``binocal/__init__.py`` sees to it that this holds too where ``binocal`` was imported first.
"""

from __future__ import annotations

import sys

ENV_ID = "binocal/StereoExtrinsics-v0"
MAX_STEPS = 25  # an episode that has not arrived by then has failed


def register_if_loaded() -> None:
    """Registers both forms of the environment where Gymnasium is loaded; a second call changes nothing."""
    gymnasium = sys.modules.get("gymnasium")
    registry = getattr(gymnasium, "registry", None)  # None while Gymnasium itself is being imported
    if gymnasium is None or registry is None or ENV_ID in registry:
        return
    gymnasium.register(
        ENV_ID,
        entry_point="binocal.rl.env:StereoExtrinsicsEnv",
        vector_entry_point="binocal.rl.env:StereoExtrinsicsVectorEnv",
        max_episode_steps=MAX_STEPS,
    )
