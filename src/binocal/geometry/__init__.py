"""Rotations, rigid transforms, homographies: numpy only, batched over leading dimensions."""

from binocal.geometry.se3 import SE3

__all__ = ["SE3"]
