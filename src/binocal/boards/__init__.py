"""Calibration boards: ids and 3-D points, nothing else."""

from binocal.boards.board import Board
from binocal.boards.spec import format_board, load_board, parse_board

__all__ = ["Board", "format_board", "load_board", "parse_board"]
