"""The viewer in a real browser: what it shows, and what people do there."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from browser import PATIENCE_MS, browser
from instok3d.formats.registry import ExportOptions, export_scene
from instok3d.pictures import color_picture
from instok3d.scene.scene import Scene
from instok3d.types import Cameras
from instok3d.viewer.app import Viewer, view
from instok3d.viewer.cameras import stand_of_view
from made_scene import HEIGHT, WIDTH, made_scene, made_tokens
from splat_scenes import furnished_scene

pytest.importorskip("viser", reason="needs viser: '.[view]'")

ENLARGED, UPLOAD_LIMIT = 3, 100_000
NASTY = "<img src=http://evil.example/x onerror=window.broken=1> ![x](http://evil.example/y)"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return furnished_scene(400, sh_count=16)


@pytest.fixture(scope="module")
def viewer(scene: Scene) -> Iterator[Viewer]:
    others = {"other.itk": made_scene(made_tokens())}
    shown = view(scene, port=0, others=others, upload_limit_bytes=UPLOAD_LIMIT)
    yield shown
    shown.stop()


@pytest.fixture(scope="module")
def page(viewer: Viewer) -> Iterator[Any]:
    """The page of the viewer, in the shape of the photos; it asked nobody else for anything."""
    size = {"width": 20 * WIDTH, "height": 20 * HEIGHT}
    context = browser().new_context(viewport=size)
    context.request.get(viewer.url)  # the token becomes a cookie
    opened = context.new_page()
    opened.set_default_timeout(PATIENCE_MS)
    asked, errors = [], []
    opened.on("request", lambda request: asked.append(request.url))
    opened.on("websocket", lambda socket: asked.append(socket.url))
    opened.on("pageerror", lambda error: errors.append(str(error)))
    # On a slow machine viser draws fewer pixels: never here, where pictures are compared.
    opened.goto(f"{viewer.url.split('?')[0]}?fixedDpr=1")
    opened.get_by_text("2 objects, 400 Gaussians").wait_for()
    yield opened
    context.close()
    own = viewer.url.split("/")[2]
    sent = [url for url in asked if url[:5] not in ("blob:", "data:")]
    assert f"ws://{own}/" in sent
    assert {url.split("/")[2] for url in sent} == {own}
    assert errors == []


@pytest.fixture(autouse=True)
def _as_at_first(viewer: Viewer) -> Iterator[None]:
    """Undo what a test did."""
    yield
    while viewer._session.can_undo:
        viewer._do(viewer._session.undo, None)
    viewer._do(viewer._session.select, None)


def until(page: Any, holds: Callable[[], bool]) -> None:
    """Wait for what the page or the server does in its own time."""
    end = time.monotonic() + PATIENCE_MS / 1000
    while not holds():
        assert time.monotonic() < end, "it never came to hold"
        page.wait_for_timeout(50)


def drawn(viewer: Viewer, scene: Scene, view: int = 0) -> np.ndarray:
    """What the browser draws from where a photo was taken."""
    (client,) = viewer._server.get_clients().values()
    stand = stand_of_view(scene, view)
    picture = client.get_render(
        ENLARGED * HEIGHT, ENLARGED * WIDTH, wxyz=np.array(stand.quat_wxyz),
        position=np.array(stand.center), fov=stand.vertical_fov_rad, transport_format="png",
        timeout=PATIENCE_MS / 1000,
    )  # fmt: skip
    return picture[..., :3]


def expected(scene: Scene, view: int = 0) -> np.ndarray:
    cameras = scene.cameras.views([view])
    intrinsics = cameras.intrinsics.clone()
    intrinsics[:, :2] *= ENLARGED
    enlarged = Cameras(cameras.cam_from_world, intrinsics)
    return color_picture(scene.render(enlarged, ENLARGED * HEIGHT, ENLARGED * WIDTH).colors[0])


def psnr(first: np.ndarray, second: np.ndarray) -> float:
    error = np.square(first.astype(float) - second.astype(float)).mean()
    return float(10 * np.log10(255**2 / max(error, 1e-9)))


def point(page: Any, x: int, y: int) -> tuple[float, float]:
    """Move the pointer to the middle of a photo's pixel, as seen from where it was taken."""
    box = page.locator("canvas").first.bounding_box()
    right, down = (x + 0.5) / WIDTH * box["width"], (y + 0.5) / HEIGHT * box["height"]
    page.mouse.move(box["x"] + right, box["y"] + down)
    return box["x"] + right, box["y"] + down


def click(page: Any, x: int, y: int, modifier: str | None = None) -> None:
    at = point(page, x, y)
    if modifier:
        page.keyboard.down(modifier)
    page.mouse.click(*at)
    if modifier:
        page.keyboard.up(modifier)


def press(page: Any, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def test_the_page_shows_the_scene(page: Any, viewer: Viewer, scene: Scene):
    until(page, lambda: psnr(drawn(viewer, scene), expected(scene)) > 40)


def test_one_stands_at_a_photo_and_sees_the_colours_from_there(
    page: Any, viewer: Viewer, scene: Scene
):
    page.get_by_role("combobox", name="Photo").click()
    page.get_by_role("option", name="1: photo1.jpg").click()
    press(page, "Stand there")
    (client,) = viewer._server.get_clients().values()
    until(page, lambda: np.allclose(client.camera.position, (0.1, 0, 0), atol=1e-3))
    until(page, lambda: psnr(drawn(viewer, scene, 1), expected(scene, 1)) > 40)
    press(page, "Compare with photo")
    page.get_by_text("photo | scene at its camera").wait_for()
    viewer._stand_at(0, client)
    until(page, lambda: np.allclose(client.camera.position, 0, atol=1e-3))


def test_a_click_selects_the_object_of_that_pixel(page: Any, viewer: Viewer, scene: Scene):
    ids = scene.render([0], ids=True).ids
    assert ids is not None
    # Left of the panel: the red box, object 1, and what belongs to no object about it.
    for x, y in [(10, 14), (3, 11), (8, 16), (11, 12)]:
        before = viewer._session.shown.place
        click(page, x, y)
        until(page, lambda before=before: viewer._session.shown.place is not before)
        assert viewer._session.shown.selected == {int(ids[0, y, x])} - {0}


def test_the_object_under_the_pointer_is_named(page: Any, scene: Scene):
    tip = page.locator("#instok3d-hover")
    point(page, 10, 14)
    tip.get_by_text("object#1", exact=True).wait_for()
    point(page, 3, 11)
    tip.wait_for(state="hidden")


def test_objects_are_selected_together_in_the_list_and_in_the_picture(page: Any, viewer: Viewer):
    page.get_by_label("object#2").check()
    until(page, lambda: viewer._session.shown.selected == {2})
    click(page, 10, 14, "Control")
    until(page, lambda: viewer._session.shown.selected == {1, 2})
    page.get_by_label("object#2").uncheck()
    until(page, lambda: viewer._session.shown.selected == {1})


def test_what_is_removed_is_gone_from_the_picture_and_comes_back(
    page: Any, viewer: Viewer, scene: Scene
):
    whole = expected(scene)
    until(page, lambda: psnr(drawn(viewer, scene), whole) > 40)
    click(page, 10, 14)
    until(page, lambda: viewer._session.shown.selected == {1})
    press(page, "Remove")
    until(page, lambda: len(viewer.scene.objects) == 1)
    without = expected(viewer.scene)
    assert psnr(whole, without) < 25
    until(page, lambda: psnr(drawn(viewer, scene), without) > 40)
    press(page, "Undo")
    until(page, lambda: len(viewer.scene.objects) == 2)
    viewer._do(viewer._session.select, None)  # what came back is selected
    until(page, lambda: psnr(drawn(viewer, scene), whole) > 40)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_object_of_another_scene_is_inserted_where_one_clicked(
    page: Any, viewer: Viewer, scene: Scene
):
    click(page, 10, 14)
    until(page, lambda: viewer._session.shown.selected == {1})
    press(page, "Insert where clicked")
    until(page, lambda: len(viewer.scene.objects) == 3)
    viewer._do(viewer._session.select, None)
    until(page, lambda: psnr(drawn(viewer, scene), expected(viewer.scene)) > 40)
    assert psnr(expected(viewer.scene), expected(scene)) < 35


def test_a_name_is_text_and_what_cannot_be_done_is_said(page: Any, viewer: Viewer):
    press(page, "Rename")
    page.get_by_text("select an object first").wait_for()
    viewer._do(lambda: viewer._session.select(2), None)
    viewer._do(lambda: viewer._session.rename(NASTY), None)
    page.get_by_text(f"{NASTY}#2", exact=True).first.wait_for()
    assert page.evaluate("() => window.broken === undefined")
    assert page.locator("img[src*=evil]").count() == 0


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_object_of_a_file_that_was_sent_is_inserted(
    page: Any, viewer: Viewer, scene: Scene, tmp_path: Path
):
    sent = tmp_path / f"{NASTY[:4]}sofa.ply"
    export_scene(furnished_scene(60), sent, ExportOptions())
    end = time.monotonic() + PATIENCE_MS / 1000
    while viewer._session.shown.selected != {1}:  # a click while the page redraws may be lost
        assert time.monotonic() < end, "no click selects the object"
        click(page, 10, 14)
        page.wait_for_timeout(1000)
    page.locator("input[type=file]").set_input_files(str(sent))
    until(page, lambda: sent.name in viewer._session.others)
    page.get_by_role("combobox", name="From").and_(
        page.locator(f"[value='{sent.name}']")
    ).wait_for()
    press(page, "Insert where clicked")
    until(page, lambda: len(viewer.scene.objects) == 3)
    assert viewer.scene.objects[-1].num_gaussians == 60
    viewer._do(viewer._session.select, None)
    until(page, lambda: psnr(drawn(viewer, scene), expected(viewer.scene)) > 40)


def test_a_file_that_is_damaged_or_too_large_is_refused_with_its_name(
    page: Any, viewer: Viewer, tmp_path: Path
):
    before, chooser = dict(viewer._session.others), page.locator("input[type=file]")
    (tmp_path / "broken.ply").write_bytes(b"nonsense")
    chooser.set_input_files(str(tmp_path / "broken.ply"))
    page.get_by_text("broken.ply is no").wait_for()
    (tmp_path / "great.ply").write_bytes(bytes(UPLOAD_LIMIT + 1))
    chooser.set_input_files(str(tmp_path / "great.ply"))
    page.get_by_text("great.ply: 100,001 bytes are more than the 100,000").wait_for()
    assert viewer._session.others == before
    assert not viewer._server.gui._current_file_upload_states
