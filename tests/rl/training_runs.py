"""Training histories made up by a formula, for tests of what reads and draws them."""

from __future__ import annotations

import numpy as np

from binocal.rl.history import TrainingHistory


def made_up_run(seed: int, targets: str = "soft", n: int = 1000) -> TrainingHistory:
    """A loss that falls from 10 to 1 with scatter, values that follow the returns, success that grows."""
    rng = np.random.default_rng(seed)
    step = np.arange(1, n + 1)
    returns = rng.uniform(-8, 0, 300)
    lag = np.where(step % 50 == 0, 0.01 + 0.002 * rng.random(n), np.nan)
    held_out = np.arange(0, n + 1, 100)
    return TrainingHistory(
        targets,
        seed,
        step,
        (1 + 9 * np.exp(-step / 100)) * np.exp(0.1 * rng.standard_normal(n)),
        lag,
        returns + 0.3 * rng.standard_normal(300),
        returns,
        held_out,
        np.minimum(0.8 + 0.2 * held_out / n, 1.0),
        6 - 2 * held_out / n + 0.1 * rng.random(len(held_out)),
    )
