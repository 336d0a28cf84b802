"""Batches held in dataclasses: one way to map a function over all of their arrays.

Estimates, equations, problems and states of the loop are frozen dataclasses and tuples of arrays whose leading dimensions are
the rigs of a batch. A field that all rigs share, as the board's points are, is declared with ``metadata=SHARED`` and passed on
as it is, and so is everything that is neither array, tuple nor dataclass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy import ndarray

from binocal.geometry import SE3
from binocal.shapes import Bool, Int

SHARED: Mapping[str, bool] = MappingProxyType({"is_shared": True})
"""Marks a dataclass field without batch dimensions: ``field(metadata=SHARED)``."""

T = TypeVar("T")


def map_arrays(function: Callable[..., ndarray], first: T, *others: T) -> T:
    """``function`` of every array of ``first`` and of its counterparts in ``others``, in values of the same structure.

    What is shared or no array is that of ``first``.
    """
    mapped: Any = first
    if isinstance(first, ndarray):
        mapped = function(first, *others)
    elif isinstance(first, SE3):  # rows of rotations are rotations: nothing to check again
        mapped = SE3.unchecked(
            function(first.R, *(o.R for o in others)),  # type: ignore[attr-defined]
            function(first.t, *(o.t for o in others)),  # type: ignore[attr-defined]
        )
    elif isinstance(first, tuple):
        mapped = tuple(map_arrays(function, *parts) for parts in zip(first, *others, strict=True))  # type: ignore[misc]
    elif is_dataclass(first):
        mapped = type(first)(
            *(
                getattr(first, f.name)
                if "is_shared" in f.metadata
                else map_arrays(function, getattr(first, f.name), *(getattr(o, f.name) for o in others))
                for f in fields(first)
            )
        )
    return mapped


def take_rigs(batch: T, index: Int[ndarray, "k"] | slice | int) -> T:
    """Those rigs of a batch; with an integer one rig, without the batch's dimension."""
    return map_arrays(lambda a: np.asarray(a[index]), batch)


def choose_rigs(take: Bool[ndarray, "*batch"], new: T, old: T) -> T:
    """Rig by rig, the new value where ``take``, else the old one."""

    def pick(a: ndarray, b: ndarray) -> ndarray:
        return np.where(take.reshape(take.shape + (1,) * (a.ndim - take.ndim)), a, b)

    return map_arrays(pick, new, old)


def stack_rigs(rigs: Sequence[T]) -> T:
    """One batch of single rigs."""
    return map_arrays(lambda *arrays: np.stack(arrays), *rigs)


def join_rigs(batches: Sequence[T]) -> T:
    """One batch of several."""
    return map_arrays(lambda *arrays: np.concatenate(arrays), *batches)


def replace_rigs(batch: T, place: Int[ndarray, "k"], new: T) -> T:
    """The batch with other rigs in those places."""

    def put(a: ndarray, b: ndarray) -> ndarray:
        out = a.copy()
        out[place] = b
        return out

    return map_arrays(put, batch, new)
