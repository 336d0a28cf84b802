from __future__ import annotations

import numpy as np
import pytest

from binocal.rl.rig_batches import RIG_SETS, RigBatch, sample_rigs


@pytest.fixture(scope="session")
def rigs() -> RigBatch:
    """Twelve rigs of the standard set."""
    return sample_rigs(RIG_SETS["standard"], 12, np.random.default_rng(7))


@pytest.fixture
def torch():
    """PyTorch on one thread: networks this small are slower when shared among threads."""
    torch = pytest.importorskip("torch", reason="PyTorch is an extra: pip install binocal[train]")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield torch
    torch.set_num_threads(before)
