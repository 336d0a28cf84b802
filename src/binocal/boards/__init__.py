"""Calibration boards: ids and 3-D points, nothing else."""

from binocal.boards.board import Board
from binocal.boards.spec import load_board, parse_board

__all__ = ["Board", "load_board", "parse_board"]
