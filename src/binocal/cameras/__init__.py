"""Camera models (projection, its inverse, its Jacobians), one camera, and the stereo rig."""

from binocal.cameras.camera import Camera
from binocal.cameras.models import CAMERA_MODELS, CameraModel, camera_model, known_camera_models
from binocal.cameras.rig import StereoRig

__all__ = ["CAMERA_MODELS", "Camera", "CameraModel", "StereoRig", "camera_model", "known_camera_models"]
