import base64
import io
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from browser import open_page
from instok3d.formats.registry import ExportOptions, export_scene
from instok3d.pictures import color_picture
from instok3d.render import render
from instok3d.scene.scene import Scene
from instok3d.scene.visibility import Sight
from instok3d.types import Gaussians
from instok3d.webpage import page as page_module
from instok3d.webpage import write_page
from made_scene import HEIGHT, WIDTH, made_empty_scene, made_scene, made_tokens

READY = "() => window.instok3d"
SIZE = (8 * HEIGHT, 8 * WIDTH)


def about_of(file: Path) -> dict[str, Any]:
    found = re.search(r'id="about-scene">(.*?)</script>', file.read_text(), re.S)
    assert found is not None
    return json.loads(found[1])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return made_scene(made_tokens(sh_count=16))


@pytest.fixture(scope="module")
def page(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    file = tmp_path_factory.mktemp("page") / "room.html"
    write_page(scene, file)
    with open_page(file.as_uri(), READY) as opened:
        yield opened
        assert opened.asked == [file.as_uri()]
        assert opened.errors == []


def drawn(page: Any, view: int = 0) -> np.ndarray:
    """What the canvas shows from an input view, at SIZE."""
    data = page.evaluate(
        """([view, height, width]) => {
            const page = window.instok3d;
            page.fixedSize = [width, height];
            page.stand(view);
            page.drawNow();
            return page.canvas.toDataURL("image/png");
        }""",
        [view, *SIZE],
    )
    picture = Image.open(io.BytesIO(base64.b64decode(data.split(",")[1])))
    return np.array(picture.convert("RGB"))


def expected(scene: Scene, gaussians: Gaussians, view: int = 0) -> np.ndarray:
    cameras = scene.cameras.views([view])
    intrinsics = cameras.intrinsics.clone()
    intrinsics[:, :2] *= 8
    near, far = scene.near_far
    cameras = replace(cameras, intrinsics=intrinsics)
    return color_picture(render(gaussians, cameras, *SIZE, near=near, far=far).colors[0])


def psnr(first: np.ndarray, second: np.ndarray) -> float:
    error = np.square(first.astype(float) - second.astype(float)).mean()
    return float(10 * np.log10(255**2 / max(error, 1e-9)))


def test_the_picture_is_ours(page: Any, scene: Scene):
    for view in range(len(scene.views)):
        assert psnr(drawn(page, view), expected(scene, scene.gaussians, view)) > 45


def test_a_pixel_picks_the_object_with_the_largest_share_of_it(page: Any, scene: Scene):
    near, far = scene.near_far
    columns = torch.nn.functional.one_hot(scene.object_ids(), 5).float()
    one_anchor_each = replace(scene.gaussians, anchor_index=torch.arange(len(columns)))
    shares = render(
        one_anchor_each, scene.cameras.views([0]), HEIGHT, WIDTH, anchor_features=columns,
        near=near, far=far,
    ).features  # fmt: skip
    assert shares is not None
    truth = torch.where(shares[0].amax(0) > 0, shares[0].argmax(0), 0)
    picked = page.evaluate(
        """([height, width]) => {
            const { scene, state, viewpoint } = window.instok3d, ids = [];
            window.instok3d.stand(0);
            for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) {
                const index = pick(scene, state, viewpoint, x + .5, y + .5, width, height);
                ids.push(index ? scene.about.objects[index - 1].id : 0);
            }
            return ids;
        }""",
        [HEIGHT, WIDTH],
    )
    assert set(picked) == {0, 1, 3}
    assert (torch.tensor(picked).view(HEIGHT, WIDTH) == truth).float().mean() > 0.995


def test_a_click_selects_and_the_list_hides_and_shows(page: Any, scene: Scene):
    whole = drawn(page)
    page.evaluate("() => window.instok3d.putBack()")
    box = page.locator("canvas").bounding_box()
    # The red blob of object 1 is left of the middle.
    page.mouse.click(box["x"] + 0.25 * box["width"], box["y"] + 0.5 * box["height"])
    pressed = page.locator(".name[aria-pressed=true]")
    assert "object#1" in pressed.first.inner_text()
    page.evaluate("() => window.instok3d.state.selected.clear()")
    page.get_by_label("hide object#1").click()
    start, count = scene.object(1).gaussian_range
    others = torch.ones(len(scene.gaussians.means), dtype=torch.bool)
    others[start : start + count] = False
    without = drawn(page)
    assert psnr(without, expected(scene, scene.gaussians.rows(others))) > 45
    commands = page.evaluate("() => window.instok3d.commands()")
    assert commands == ["instok3d edit SCENE hide object#1"]
    page.get_by_label("show object#1").click()
    assert (drawn(page) == whole).all()


def test_what_is_moved_is_drawn_there_and_said_as_a_command(page: Any, scene: Scene):
    page.evaluate(
        "() => { window.instok3d.putBack(); window.instok3d.move(1, [0.25, -0.125, 0.5]); }"
    )
    start, count = scene.object(1).gaussian_range
    means = scene.gaussians.means.clone()
    means[start : start + count] += torch.tensor([0.25, -0.125, 0.5])
    assert psnr(drawn(page), expected(scene, replace(scene.gaussians, means=means))) > 45
    commands = page.evaluate("() => window.instok3d.commands()")
    assert commands == ["instok3d edit SCENE move object#1 --by 0.25 -0.125 0.5"]
    page.evaluate("() => window.instok3d.putBack()")
    assert psnr(drawn(page), expected(scene, scene.gaussians)) > 45


def test_a_scene_without_objects_or_gaussians_opens(tmp_path: Path):
    empty = made_empty_scene()
    bare = replace(empty, gaussians=empty.gaussians.rows(slice(0, 0)))
    report = write_page(bare, tmp_path / "empty.html")
    assert report.sh_degree == 0
    with open_page((tmp_path / "empty.html").as_uri(), READY) as opened:
        assert (drawn(opened) == 0).all()
        assert opened.errors == []


def test_names_are_text_and_nothing_else(tmp_path: Path, scene: Scene):
    nasty = "</script><script>window.broken = 1</script>"
    items = tuple(replace(item, key=nasty) for item in scene.objects[:1])
    write_page(replace(scene, objects=items), tmp_path / "a.html", name=nasty)
    assert about_of(tmp_path / "a.html")["objects"][0]["key"] == nasty
    with open_page((tmp_path / "a.html").as_uri(), READY) as opened:
        assert opened.evaluate("() => window.broken === undefined")
        assert opened.locator("h1").inner_text() == nasty


def test_colours_lose_degrees_where_the_file_would_be_too_large(
    tmp_path: Path, scene: Scene, monkeypatch: pytest.MonkeyPatch
):
    whole = write_page(scene, tmp_path / "whole.html")
    assert (whole.sh_degree, whole.scene_sh_degree) == (3, 3)
    assert whole.bytes == (tmp_path / "whole.html").stat().st_size
    monkeypatch.setattr(page_module, "SIZE_LIMIT", whole.bytes - 1)
    smaller = write_page(scene, tmp_path / "smaller.html")
    assert (smaller.sh_degree, smaller.scene_sh_degree) == (2, 3)
    assert about_of(tmp_path / "smaller.html")["coefficients"] == 9
    monkeypatch.setattr(page_module, "SIZE_LIMIT", 0)
    assert write_page(scene, tmp_path / "smallest.html").sh_degree == 0


def test_a_scene_without_photos_begins_around_it(tmp_path: Path, scene: Scene):
    none = scene.cameras.views([])
    items = tuple(replace(item, sight=Sight()) for item in scene.objects)
    bare = replace(scene, objects=items, views=(), photos=scene.photos[:0], cameras=none)
    write_page(bare, tmp_path / "a.html")
    views = about_of(tmp_path / "a.html")["views"]
    assert [view["file"] for view in views] == [f"around {number}" for number in range(1, 7)]
    with open_page((tmp_path / "a.html").as_uri(), READY) as opened:
        assert drawn(opened).max() > 50
        assert opened.errors == []


def test_hidden_objects_are_left_out(tmp_path: Path, scene: Scene):
    write_page(scene.hide(1), tmp_path / "a.html")
    about = about_of(tmp_path / "a.html")
    assert [item["id"] for item in about["objects"]] == [3]
    assert any(line.startswith("edited: 1 operation, source sha256") for line in about["lines"])


def test_a_page_replaces_nothing_unasked(tmp_path: Path, scene: Scene):
    (tmp_path / "a.html").write_text("mine")
    with pytest.raises(FileExistsError):
        write_page(scene, tmp_path / "a.html", overwrite=False)
    assert (tmp_path / "a.html").read_text() == "mine"
    export_scene(scene, tmp_path / "a.html", ExportOptions(sh_degree=0, overwrite=True))
    assert about_of(tmp_path / "a.html")["coefficients"] == 1


def test_an_edited_scene_is_written_as_it_is_drawn(tmp_path: Path, scene: Scene):
    # Object 3 is hidden; the copy of object 1 stands behind the cameras, so that no view shows it.
    edited = scene.hide(3).duplicate(1, (0, 0, -9))
    write_page(edited, tmp_path / "room.html")
    about = about_of(tmp_path / "room.html")
    assert [item["key"] for item in about["objects"]] == ["object#1", "object#5"]
    assert f"edited: 2 operations, source sha256 {edited.provenance.edited_from}" in about["lines"]
