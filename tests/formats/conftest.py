import pytest

from instok3d.scene.scene import Scene
from made_scene import made_empty_scene, made_scene, made_tokens


@pytest.fixture
def scene() -> Scene:
    return made_scene(made_tokens())


@pytest.fixture
def empty_scene() -> Scene:
    return made_empty_scene()
