"""Closed-form starts: vanishing points to intrinsics, homographies to poses, poses to rig.

And the checks between views. numpy only.
"""
