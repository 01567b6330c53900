"""What stands in the 3D picture, by what the server holds; no browser is there."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from instok3d.geometry.moving import quat_about
from instok3d.scene.scene import Scene
from instok3d.viewer.app import Viewer, view
from made_scene import made_scene, made_tokens

pytest.importorskip("viser", reason="needs viser: '.[view]'")


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    shown = view(made_scene(made_tokens()), port=0)
    yield shown
    shown.stop()


def node(viewer: Viewer, name: str) -> Any:
    return viewer._server.scene.get_handle_by_name(name)


def hand(viewer: Viewer, number: int) -> Any:
    """The gizmo at an object."""
    viewer._do(lambda: viewer._use_gizmo(True), None)
    viewer._do(lambda: viewer._session.select(number), None)
    return node(viewer, "/gizmo")


def drag(gizmo: Any, position: tuple[float, ...], quat_wxyz: tuple[float, ...]) -> None:
    """As viser does it for a browser: a step, and the end."""
    gizmo._impl.position, gizmo._impl.wxyz = np.array(position), np.array(quat_wxyz)
    for phase in ("update", "end"):
        for callback in gizmo._impl_aux.update_cb:
            callback(type("Event", (), {"phase": phase, "target": gizmo, "client": None})())


def test_the_gizmo_stands_at_one_selected_object_and_goes_with_it(viewer: Viewer):
    assert hand(viewer, 1) is not None
    viewer._do(lambda: viewer._session.select(1, 3), None)
    assert node(viewer, "/gizmo") is None
    viewer._do(lambda: viewer._session.select(3), None)
    viewer._do(viewer._session.remove, None)
    assert node(viewer, "/gizmo") is None


def test_a_drag_is_one_edit_and_the_node_stands_where_its_gaussians_are(viewer: Viewer):
    before = viewer.scene
    gizmo = hand(viewer, 1)
    pivot = torch.tensor(gizmo.position, dtype=torch.float64)
    by, turn = (0.3, -0.1, 0.2), quat_about((0.0, 1.0, 0.0), 0.7)
    drag(gizmo, tuple((pivot + torch.tensor(by)).tolist()), turn)
    assert len(viewer.scene.edits) == 1
    expected = before.move(1, by, yaw=np.degrees(0.7), axis=(0, 1, 0), about=pivot.tolist())
    torch.testing.assert_close(
        viewer.scene.gaussians.means, expected.gaussians.means, atol=1e-5, rtol=0
    )
    drawn = node(viewer, "/objects/1")
    assert np.allclose(drawn.position, 0)
    assert np.allclose(drawn.wxyz, (1, 0, 0, 0))
    own = viewer.scene.gaussians.means[:12].numpy()
    assert np.allclose(drawn.centers * drawn.scale, own, atol=1e-4)


def test_a_drag_that_goes_nowhere_is_no_edit(viewer: Viewer):
    gizmo = hand(viewer, 1)
    drag(gizmo, tuple(gizmo.position), (1.0, 0.0, 0.0, 0.0))
    assert viewer.scene.edits == ()


def test_a_drag_that_cannot_be_done_leaves_the_object_where_it_was(viewer: Viewer):
    drag(hand(viewer, 1), (1e12, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    assert viewer.scene.edits == ()
    assert np.allclose(node(viewer, "/objects/1").position, 0)


def test_nodes_are_those_of_the_scene(viewer: Viewer):
    names = {number for number in range(9) if node(viewer, f"/objects/{number}") is not None}
    assert names == {0, 1, 3}
    viewer._do(lambda: viewer._session.select(1), None)
    viewer._do(viewer._session.hide, None)
    assert node(viewer, "/objects/1") is None
    viewer._do(viewer._session.undo, None)
    assert node(viewer, "/objects/1") is not None
    assert [node(viewer, f"/photos/{index}").visible for index in (0, 1)] == [False, False]


def test_a_notebook_gets_a_link_and_a_stopped_viewer_changes_nothing():
    viewer = made_scene(made_tokens()).view()
    assert f'href="{viewer.url}"' in viewer._repr_html_()
    viewer.stop()
    viewer._do(lambda: viewer._session.edit(lambda scene: scene.hide(1)), None)
    assert isinstance(viewer.scene, Scene)
    assert viewer.scene.edits == ()
