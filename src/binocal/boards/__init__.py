"""Calibration boards: ids and 3-D points, nothing else."""

from binocal.boards.board import Board, format_board, parse_board
from binocal.boards.board_set import BoardSet
from binocal.boards.target_file import load_board

__all__ = ["Board", "BoardSet", "format_board", "load_board", "parse_board"]
