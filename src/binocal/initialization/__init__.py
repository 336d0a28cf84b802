"""Closed-form starts: vanishing points to intrinsics, homographies to poses, poses to rig; the checks between views."""
