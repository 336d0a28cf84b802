"""One suite over every camera model in the registry."""

from __future__ import annotations

import pytest

from binocal.cameras import CAMERA_MODELS, camera_model, known_camera_models
from contracts import CAMERA_CONTRACT


@pytest.mark.parametrize("check", CAMERA_CONTRACT, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", CAMERA_MODELS)
def test_contract(name, check):
    check(name)


def test_an_unknown_name_is_answered_with_the_known_ones():
    assert known_camera_models()[: len(CAMERA_MODELS)] == tuple(CAMERA_MODELS)
    with pytest.raises(ValueError, match="'brown9'; known: brown4, brown5, brown8, fisheye4"):
        camera_model("brown9")
