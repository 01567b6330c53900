"""A reconstructed scene: its objects, and pictures of them from anywhere."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Int
from torch import Tensor

from instok3d.geometry.cameras import resize_intrinsics
from instok3d.render import render
from instok3d.scene.files import load_record, save_record
from instok3d.scene.id_maps import group_maps
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import SceneRecord
from instok3d.types import Cameras, Gaussians, Rendering


@dataclass(frozen=True)
class Pictures(Rendering):
    """Rendered views of a scene, with object ids where they were asked for."""

    ids: Int[Tensor, "view height width"] | None = None
    """Object id of every pixel, 0 where no object is; None unless asked for."""


@dataclass(frozen=True)
class Scene(SceneRecord):
    """Objects and the Gaussians they consist of.

    An anchor belongs to the group with the largest assignment probability, or to none where the
    void's is larger. Such a group is an object when it also wins enough pixels of some input
    view (`from_tokens.MIN_PIXELS`); all other Gaussians are the rest, which renders like the
    objects and belongs to none of them.
    """

    def object(self, which: int | str) -> SceneObject:
        """The object of an id or a key such as "object#3".

        Raises:
            KeyError: The scene has no such object.
        """
        for candidate in self.objects:
            if which in (candidate.id, candidate.key):
                return candidate
        known = ", ".join(str(candidate.id) for candidate in self.objects) or "none"
        raise KeyError(f"no object {which!r} in this scene; its ids are: {known}")

    def render(
        self,
        cameras: Cameras | Sequence[int] | None = None,
        height: int | None = None,
        width: int | None = None,
        *,
        only: int | str | Sequence[int | str] | None = None,
        ids: bool = False,
        background: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> Pictures:
        """Pictures from the input views, from some of them, or from any cameras.

        Args:
            cameras: Unbatched, in the scene's world, intrinsics for the asked size; or indices
                of input views; or None for all of those.
            height: Of the pictures, pixels; the scene's own when None. Intrinsics of input
                views are scaled to it.
            width: Likewise.
            only: Ids or keys of the objects to draw; None draws everything, the rest too.
            ids: Return id maps too (not differentiable; see `group_maps`).
            background: sRGB behind everything.

        Raises:
            KeyError: `only` names an object that is not there.
            ValueError: An index of a view that is not there.
        """
        height, width = height or self.height, width or self.width
        if not isinstance(cameras, Cameras):
            cameras = self._input_cameras(cameras, height, width)
        gaussians = self.gaussians if only is None else self.part(only)
        near, far = self.near_far
        rendering = render(
            gaussians, cameras, height, width, background=tuple(background), near=near, far=far
        )
        id_maps = self._id_maps(gaussians, cameras, height, width) if ids else None
        return Pictures(rendering.colors, rendering.alphas, rendering.depths, ids=id_maps)

    def part(self, only: int | str | Sequence[int | str]) -> Gaussians:
        """The Gaussians of one or some objects, in the scene's order.

        Raises:
            KeyError: The scene has no such object.
        """
        names = [only] if isinstance(only, int | str) else only
        rows = torch.zeros(len(self.gaussians.means), dtype=torch.bool)
        for name in names:
            start, count = self.object(name).gaussian_range
            rows[start : start + count] = True
        rows = rows.to(self.gaussians.means.device)
        return self.gaussians.rows(rows)

    def object_ids(self) -> Int[Tensor, " gaussian"]:
        """The id of the object of each Gaussian, 0 for the rest."""
        ids = torch.zeros(len(self.gaussians.means), dtype=torch.long)
        for item in self.objects:
            start, count = item.gaussian_range
            ids[start : start + count] = item.id
        return ids

    @staticmethod
    def load(path: str | Path) -> "Scene":
        """The scene of a folder; see `instok3d.scene.files.load_record`."""
        return Scene(**vars(load_record(Path(path))))

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the scene folder, without previews; see `instok3d.scene.files.save_record`."""
        save_record(self, Path(path), overwrite=overwrite)

    def _input_cameras(self, views: Sequence[int] | None, height: int, width: int) -> Cameras:
        indices = list(range(len(self.views)) if views is None else views)
        if any(not 0 <= index < len(self.views) for index in indices):
            raise ValueError(f"views must lie in 0..{len(self.views) - 1}, got {indices}")
        intrinsics = resize_intrinsics(
            self.cameras.intrinsics[indices],
            scale_x=width / self.width,
            scale_y=height / self.height,
        )
        return Cameras(self.cameras.cam_from_world[indices], intrinsics)

    @torch.no_grad()
    def _id_maps(
        self, gaussians: Gaussians, cameras: Cameras, height: int, width: int
    ) -> Int[Tensor, "view {height} {width}"]:
        """View by view: the maps of all groups in all views together could fill the memory."""
        id_of_group = torch.zeros(self.tokens.assignment.shape[1], dtype=torch.long)
        for item in self.objects:
            id_of_group[item.id - 1] = item.id
        near, far = self.near_far
        maps = torch.zeros(len(cameras.intrinsics), height, width, dtype=torch.long)
        for view in range(len(maps)):
            winners = group_maps(
                gaussians, self.tokens.assignment, cameras.view(view), height, width,
                near=near, far=far,
            )  # fmt: skip
            maps[view] = id_of_group[winners.groups.cpu()]
        return maps
