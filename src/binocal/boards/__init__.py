"""Calibration boards: ids and 3-D points, nothing else."""

from binocal.boards.board import Board, format_board, parse_board
from binocal.boards.target_file import load_board

__all__ = ["Board", "format_board", "load_board", "parse_board"]
