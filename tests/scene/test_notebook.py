import base64
import io
import re
from dataclasses import replace

import pytest
from PIL import Image

from instok3d.scene import notebook
from instok3d.scene.scene import Scene


def sheet_of(shown: str) -> Image.Image:
    data = re.search(r"data:image/jpeg;base64,([^\"]+)", shown)
    assert data is not None
    return Image.open(io.BytesIO(base64.b64decode(data[1])))


def test_a_scene_shows_its_sheet_in_a_notebook(scene: Scene, empty_scene: Scene):
    shown = scene._repr_html_()
    assert "&lt;Scene objects=2" in shown
    assert "smaller objects" not in shown
    assert sheet_of(shown).height > sheet_of(empty_scene._repr_html_()).height


def test_of_many_objects_the_largest_are_shown(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(notebook, "MOST_OBJECTS", 1)
    drawn = []
    picture = notebook.object_picture

    def spy(scene: Scene, item):
        drawn.append(item.id)
        return picture(scene, item)

    monkeypatch.setattr(notebook, "object_picture", spy)
    assert "1 smaller objects are not on the sheet" in scene._repr_html_()
    assert drawn == [1]


def test_names_are_text(scene: Scene):
    items = tuple(
        replace(item, label="<script>", key=f"<script>#{item.id}") for item in scene.objects
    )
    assert "<script>" not in replace(scene, objects=items)._repr_html_()
