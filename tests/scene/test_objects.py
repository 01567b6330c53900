from dataclasses import replace

from instok3d.pictures import display_color
from instok3d.scene.objects import SceneObject
from instok3d.scene.scene import Scene


def test_an_object_shows_itself_on_a_short_line(scene: Scene):
    for item in scene.objects:
        assert repr(item).startswith(f"<SceneObject {item.key} gaussians={item.num_gaussians} ")
        assert len(repr(item)) < 120
    named = replace(scene.objects[0], label="chair")
    assert repr(named).startswith("<SceneObject object#1 label='chair' ")


def test_a_record_survives_json(scene: Scene):
    for item in scene.objects:
        assert SceneObject.from_json(item.to_json((0.0, -1.0, 0.0))) == item


def test_neighbouring_ids_have_different_colors():
    colors = [display_color(index) for index in range(1, 41)]
    assert len(set(colors)) == 40
    assert all(len(color) == 7 and color[0] == "#" for color in colors)
