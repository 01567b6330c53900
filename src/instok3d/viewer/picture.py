"""The 3D picture of a viewer: splats, the cameras of the photos, and a gizmo to move things."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from instok3d.geometry.moving import Point, Similarity
from instok3d.scene.edits.placing import base_of_object
from instok3d.viewer.cameras import first_stand, stand_of_view, typical_distance
from instok3d.viewer.session import Shown
from instok3d.viewer.splats import Part, drawn_alike, parts_of, splats_of

if TYPE_CHECKING:
    import viser

FRUSTUM, GIZMO = 0.08, 0.25
"""Sizes in typical distances of the scene."""


class Picture:
    """What stands in the 3D picture of a server; `show` brings it up to date."""

    def __init__(
        self,
        server: "viser.ViserServer",
        shown: Shown,
        *,
        stand_at: Callable[[int], None],
        moved: Callable[[int, Similarity], None],
    ) -> None:
        """Draw a scene.

        Args:
            server: Empty.
            shown: What is to be seen at first.
            stand_at: Called with the index of a photo whose camera was clicked.
            moved: Called with an object's id and how it was moved by the gizmo.
        """
        self._server = server
        self._moved = moved
        self._shown = shown
        self._eye: Point = first_stand(shown.scene).center
        self._parts: dict[int, Part] = {}
        self._nodes: dict[int, Any] = {}
        self._gizmo: tuple[int, Any] | None = None
        self.with_gizmo = False
        server.scene.set_up_direction(shown.scene.vertical.up)
        server.scene.world_axes.visible = False
        server.scene.configure_environment_map(None)  # splats need no light; loading it dims them
        server.scene.set_background_image(np.zeros((1, 1, 3), np.uint8), format="png")
        self._photos = self._add_photos(stand_at)
        self.show(shown)

    def show(self, shown: Shown, *, eye: Point | None = None) -> None:
        """Draw what is new, and take away what has gone.

        Args:
            shown: What is to be seen.
            eye: From where colours are seen; None keeps the last one.
        """
        colors_change = (
            eye is not None and eye != self._eye and shown.scene.gaussians.sh.shape[1] > 1
        )
        self._eye = self._eye if eye is None else eye
        before, parts = self._shown.scene, parts_of(shown)
        with self._server.atomic():
            for number in set(self._nodes) - set(parts):
                self._nodes.pop(number).remove()
            for number, part in parts.items():
                last = self._parts.get(number)
                if (
                    last is None
                    or colors_change
                    or not drawn_alike(before, shown.scene, last, part)
                ):
                    self._draw(number, shown, part)
            self._shown, self._parts = shown, parts
            self._place_gizmo()

    def show_photos(self, on: bool) -> None:
        """Show the cameras of the photos, or hide them."""
        for node in self._photos:
            node.visible = on

    def _draw(self, number: int, shown: Shown, part: Part) -> None:
        splats = splats_of(shown.scene, part, self._eye)
        arrays = splats.centers, splats.covariances, splats.colors, splats.opacities
        node = self._nodes.get(number)
        if node is not None and node.scale == splats.unit:
            node.set_gaussians(*arrays)
            return
        self._nodes[number] = self._server.scene.add_gaussian_splats(
            f"/objects/{number}", *arrays, scale=splats.unit
        )

    def _add_photos(self, stand_at: Callable[[int], None]) -> list[Any]:
        scene, nodes = self._shown.scene, []
        for view in range(len(scene.views)):
            stand = stand_of_view(scene, view)
            node = self._server.scene.add_camera_frustum(
                f"/photos/{view}", stand.vertical_fov_rad, stand.aspect,
                scale=FRUSTUM * typical_distance(scene), thickness=2.0, thickness_units="screen",
                image=scene.photos[view].cpu().numpy(), wxyz=stand.quat_wxyz,
                position=stand.center, visible=False,
            )  # fmt: skip
            node.on_click(lambda _, view=view: stand_at(view))
            nodes.append(node)
        return nodes

    def _place_gizmo(self) -> None:
        """Put the gizmo at the base of the one selected object, or take it away."""
        if self._gizmo is not None:
            number, gizmo = self._gizmo
            gizmo.remove()
            self._gizmo = None
            if number in self._nodes:  # where it was dragged to is now in its Gaussians, or refused
                _place(self._nodes[number], Similarity())
        scene, selected = self._shown.scene, self._shown.selected
        if not self.with_gizmo or len(selected) != 1:
            return
        (number,) = selected
        pivot = base_of_object(scene, scene.object(number))
        gizmo = self._server.scene.add_transform_controls(
            "/gizmo", GIZMO * typical_distance(scene), position=pivot, depth_test=False
        )
        self._gizmo = number, gizmo
        node = self._nodes.get(number)

        def motion() -> Similarity:
            by = [float(there) - here for there, here in zip(gizmo.position, pivot, strict=True)]
            return Similarity.about(pivot, quat_wxyz=[float(each) for each in gizmo.wxyz], by=by)

        @gizmo.on_update
        def _(event: Any) -> None:
            if event.phase != "end":
                if node is not None:
                    _place(node, motion())
            elif motion() != Similarity():
                self._moved(number, motion())


def _place(node: Any, motion: Similarity) -> None:
    """Draw a node moved, without a change of its Gaussians."""
    node.wxyz, node.position = motion.quat_wxyz, motion.translation
