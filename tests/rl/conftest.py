from __future__ import annotations

import numpy as np
import pytest

from binocal.rl.rig_batches import CASE_SETS, Cases, sample_cases


@pytest.fixture(scope="session")
def cases() -> Cases:
    """Twelve rigs of the standard set."""
    return sample_cases(CASE_SETS["standard"], 12, np.random.default_rng(7))


@pytest.fixture
def torch():
    """PyTorch on one thread: networks this small are slower when shared among threads."""
    torch = pytest.importorskip("torch", reason="PyTorch is an extra: pip install binocal[train]")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield torch
    torch.set_num_threads(before)
