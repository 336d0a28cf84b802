"""Simulator: rigs, board poses, corners with every kind of fault, and rendered images, all with exact truth."""

from binocal.simulation.corruptions import (
    drop_view,
    exchange_columns_and_rows,
    flip_all,
    flip_all_left,
    flip_view,
    halve_right_resolution,
    mismatch_pair,
    repeat_view,
    shift_all_pairs,
    shift_view_by_row,
    state_image_size,
    swap_cameras,
    swap_image_size,
    zero_view,
)
from binocal.simulation.layout import printed_extent_m
from binocal.simulation.match_drawing import WRONG_KINDS
from binocal.simulation.matches import (
    MatchDistribution,
    MatchProblems,
    SimulatedMatches,
    sample_match_problems,
    simulate_matches,
)
from binocal.simulation.noise import add_outliers, drop_corners, simulate_detections
from binocal.simulation.pairs import render_pairs, render_scene_pairs
from binocal.simulation.renderer import RenderedImage, RenderOptions, render_image, render_light
from binocal.simulation.rigs import random_rig, table2_rig
from binocal.simulation.rooms import Room, draw_room, render_room
from binocal.simulation.scene_renderer import SceneOptions, render_scene_image
from binocal.simulation.scenes import (
    PoseOptions,
    StereoScene,
    fronto_parallel,
    same_pose,
    sample_board_poses,
    sample_scene,
)
from binocal.simulation.setups import SETUPS, Setup
from binocal.simulation.textured_scenes import TEXTURED_SCENES, TexturedScene, draw_textured_scene
from binocal.simulation.visibility import visible_px

__all__ = [
    "SETUPS",
    "TEXTURED_SCENES",
    "WRONG_KINDS",
    "MatchDistribution",
    "MatchProblems",
    "PoseOptions",
    "RenderOptions",
    "RenderedImage",
    "Room",
    "SceneOptions",
    "Setup",
    "SimulatedMatches",
    "StereoScene",
    "TexturedScene",
    "add_outliers",
    "draw_room",
    "draw_textured_scene",
    "drop_corners",
    "drop_view",
    "exchange_columns_and_rows",
    "flip_all",
    "flip_all_left",
    "flip_view",
    "fronto_parallel",
    "halve_right_resolution",
    "mismatch_pair",
    "printed_extent_m",
    "random_rig",
    "render_image",
    "render_light",
    "render_pairs",
    "render_room",
    "render_scene_image",
    "render_scene_pairs",
    "repeat_view",
    "same_pose",
    "sample_board_poses",
    "sample_match_problems",
    "sample_scene",
    "shift_all_pairs",
    "shift_view_by_row",
    "simulate_detections",
    "simulate_matches",
    "state_image_size",
    "swap_cameras",
    "swap_image_size",
    "table2_rig",
    "visible_px",
    "zero_view",
]
