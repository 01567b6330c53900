"""A reconstructed scene: its objects, and pictures of them from anywhere."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from instok3d.hub.fetching import fetch
from instok3d.hub.references import is_hub
from instok3d.model.memory import refuse_beyond
from instok3d.render import render
from instok3d.scene.edits.editable import EditableScene
from instok3d.scene.edits.folder import read_history, save_history
from instok3d.scene.edits.holes import holes_left
from instok3d.scene.edits.ownership import drawn_rows, row_ids
from instok3d.scene.files import load_record
from instok3d.scene.id_maps import COLUMNS, group_maps
from instok3d.scene.neighbours import Neighbour, find_neighbours
from instok3d.scene.objects import SceneObject, find_object
from instok3d.scene.picture_size import SizedCameras, check_picture_size, resize_cameras
from instok3d.semantics.tokens import pixel_features, render_semantics
from instok3d.types import Cameras, Gaussians, Rendering

if TYPE_CHECKING:
    from instok3d.scene.description import Description
    from instok3d.scene.object_list import Scale
    from instok3d.scene.query import Answers
    from instok3d.semantics.query.encoder import QueryEncoder
    from instok3d.viewer.app import Viewer

NONE: Mapping[str, "Scene"] = MappingProxyType({})
MAP_BYTES = 10
"""Peak memory for each pixel and group of a view's id map, measured with 40 groups."""


@dataclass(frozen=True)
class Pictures(Rendering):
    """Rendered views of a scene, with object ids where they were asked for."""

    ids: Int[Tensor, "view height width"] | None = None
    """Object id of every pixel, 0 where no object is; None unless asked for."""


@dataclass(frozen=True, repr=False)
class Scene(EditableScene):
    """Objects and the Gaussians they consist of.

    An anchor belongs to the group with the largest assignment probability, or to none where the
    void's is larger. Such a group is an object when it also wins enough pixels of some input
    view (`from_tokens.MIN_PIXELS`); all other Gaussians are the rest, which renders like the
    objects and belongs to none of them.
    """

    def _repr_html_(self) -> str:
        """What a notebook shows: the contact sheet; see `scene.notebook`."""
        from instok3d.scene.notebook import scene_html  # it draws scenes, so it imports this file

        return scene_html(self)

    def view(self, *, port: int = 0, others: Mapping[str, "Scene"] = NONE) -> "Viewer":
        """Show the scene in the browser, on this machine alone; returns at once.

        Edits that are made there are in the scene of what is returned; this one stays.

        Args:
            port: The first free one from this on is taken; 0 takes any.
            others: Scenes whose objects can be inserted, by name.

        Raises:
            ModuleNotFoundError: viser is not installed.
        """
        from instok3d.viewer.app import view  # a later layer, which only people reach from here

        return view(self, port=port, others=others)

    def object(self, which: int | str) -> SceneObject:
        """The object of an id, a key such as "object#3", or a label.

        Raises:
            KeyError: The scene has no such object, or several of that label.
        """
        return find_object(self.objects, which)

    def query(
        self,
        text: str | None = None,
        *,
        image: Float[Tensor, "3 height width"] | None = None,
        k: int = 5,
        encoder: "QueryEncoder | None" = None,
    ) -> "Answers":
        """The objects that a text or a picture means, the likeliest first; none if none is.

        A text names a thing, with a colour, a material, a size or a place, such as "the red chair
        next to the window"; sizes and places are those of boxes. "all chairs" asks for all of
        them. Hidden objects are not there. See docs/queries.md.

        Args:
            text: What is looked for, or
            image: a picture of one thing, sRGB in [0, 1].
            k: At most so many objects, unless the text asks for several.
            encoder: Of the scene's semantics; None takes the one that comes with instok3d.

        Raises:
            ValueError: The scene has no semantics, the text is not understood, both or neither of
                text and image are given, or k is below 1.
            FileNotFoundError: No weights of the encoder are there (MissingWeightsError).
        """
        from instok3d.scene.query import SceneQueries  # the encoder's weights come with it
        from instok3d.semantics.query.shipped import find_encoder

        if (text is None) == (image is None):
            raise ValueError("give a text or an image to search for, one of the two")
        if k < 1:
            raise ValueError(f"k must be at least 1, got {k}")
        queries = SceneQueries(self, encoder or find_encoder(self.semantics))
        if image is not None:
            return queries.picture(image, k)
        assert text is not None
        return queries.text(text, k)

    def describe(self, scale: "Scale | None" = None, *, most: int = 60) -> "Description":
        """The scene in a few words (`str()`) or plain values (`to_json()`); see docs/queries.md.

        Hidden objects are counted but not described. Renders the input views, for colours.

        Args:
            scale: Of lengths; None takes what the scene knows itself.
            most: Only so many objects, the largest ones.

        Raises:
            ValueError: `most` is below 1.
        """
        from instok3d.scene.description import describe  # it draws scenes, so it imports this file

        return describe(self, scale, most=most)

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
            height: Of the pictures, pixels. Input views keep their shape where one side alone is
                given, and are of the scene's own size where none is; where both are, they see
                more on two sides instead of being stretched, with a warning.
            width: Likewise.
            only: Ids or keys of the objects to draw, hidden ones too; None draws everything that is
                not hidden, the rest too.
            ids: Return id maps too (not differentiable; see `group_maps`).
            background: sRGB behind everything.

        Raises:
            KeyError: `only` names an object that is not there.
            ValueError: An index of a view that is not there, or a size of which no picture can be
                made (`check_picture_size`).
            NotEnoughMemoryError: Id maps of this size are predicted not to fit.
        """
        sized = self._sized(cameras, height, width)
        cameras, height, width = sized.cameras, sized.height, sized.width
        gaussians = self.drawn_gaussians() if only is None else self.part(only)
        near, far = self.near_far
        rendering = render(
            gaussians, cameras, height, width, background=tuple(background), near=near, far=far
        )
        id_maps = self._id_maps(gaussians, cameras, height, width) if ids else None
        return Pictures(rendering.colors, rendering.alphas, rendering.depths, ids=id_maps)

    def holes(
        self,
        cameras: Cameras | Sequence[int] | None = None,
        height: int | None = None,
        width: int | None = None,
    ) -> Bool[Tensor, "view height width"]:
        """Where pictures showed what was removed and show nothing now.

        Removals that the scene can undo count; a scene made anew from an edited one (refined, for
        example) knows none.

        Args:
            cameras: As of `render`, likewise height and width.
            height: Of the masks, pixels.
            width: Likewise.

        Raises:
            ValueError: As `render`.
        """
        sized = self._sized(cameras, height, width)
        size = sized.height, sized.width
        if self.history is None:
            return torch.zeros(len(sized.cameras.intrinsics), *size, dtype=torch.bool)
        return holes_left(self.history, self, sized.cameras, *size)

    def neighbours(self) -> dict[int, tuple[Neighbour, ...]]:
        """With which others each object shares its surface in the input views, by id.

        The first is the one to `merge` with where a part of an object was left behind. Hidden
        objects, and those of a scene without views, have none.
        """
        ids = [item.id for item in self.objects]
        if not self.views:
            return dict.fromkeys(ids, ())
        pictures = self.render(ids=True)
        assert pictures.ids is not None
        return find_neighbours(pictures.ids, pictures.depths, ids)

    @torch.no_grad()
    def render_features(
        self,
        encoder: str,
        cameras: Cameras | Sequence[int] | None = None,
        height: int | None = None,
        width: int | None = None,
    ) -> Float[Tensor, "view feature rows columns"]:
        """What an encoder sees in pictures of the scene: F of every pixel (Eq. 7).

        Not divided by alpha, so that nothing is zeros. Not differentiable.

        Args:
            encoder: A name among `semantics`.
            cameras: As of `render`, likewise height and width.
            height: Of the maps, pixels.
            width: Likewise.

        Raises:
            KeyError: The scene has no semantics of this encoder.
            ValueError: As `render`.
        """
        if encoder not in self.semantics:
            known = ", ".join(self.semantics) or "none"
            raise KeyError(f"the scene has no semantics of {encoder!r}; there are: {known}")
        sized, (near, far) = self._sized(cameras, height, width), self.near_far
        tokens = self.semantics[encoder].batched()
        maps = render_semantics(
            self.drawn_gaussians().map(lambda value: value[None]), self.tokens.assignment[None],
            tokens, sized.cameras.map(lambda value: value[None]), sized.height, sized.width,
            near=near, far=far,
        )  # fmt: skip
        return pixel_features(maps, tokens)[0]

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

    def drawn_gaussians(self) -> Gaussians:
        """The Gaussians without those of hidden objects, in the scene's order."""
        if not any(item.hidden for item in self.objects):
            return self.gaussians
        return self.gaussians.rows(drawn_rows(self).to(self.gaussians.means.device))

    def object_ids(self) -> Int[Tensor, " gaussian"]:
        """The id of the object of each Gaussian, 0 for the rest."""
        return row_ids(self)

    def drawn(self) -> "Scene":
        """The scene without its hidden objects, for what is exported; hiding was the edit."""
        hidden = [item.id for item in self.objects if item.hidden]
        if not hidden:
            return self
        return replace(self.remove(*hidden), provenance=self.provenance)

    @staticmethod
    def load(path: str | Path, *, edits: bool = True) -> "Scene":
        """The scene of a folder, with the edits of its log; without them it is the source.

        Args:
            path: The folder, or hub:USER/NAME or hub:USER/NAME@REVISION on the hub.
            edits: Whether to do the edits.

        Raises:
            FileNotFoundError, ValueError: See `instok3d.scene.edits.folder.read_history`.
            ModuleNotFoundError, PermissionError, ConnectionError: See
                `instok3d.hub.fetching.fetch`.
        """
        folder, hub = Path(path), ""
        if is_hub(path):
            found = fetch(path, "scene")
            folder, hub = found.folder, str(found.reference)
        if not edits:
            return Scene(**vars(load_record(folder, hub=hub)))
        history = read_history(folder, hub=hub)
        return Scene(**vars(history.current), history=history)

    def save(
        self,
        path: str | Path,
        *,
        overwrite: bool = False,
        more: Callable[[Path], None] | None = None,
    ) -> None:
        """Write the scene folder, without previews; of an edited scene the source and the log.

        Args:
            path: The folder, such as room.itk.
            overwrite: Replace a scene that is already there.
            more: Called with the folder before it gets its name, to write more files into it.

        Raises:
            FileExistsError, FileNotFoundError, PermissionError, ValueError: See
                `instok3d.scene.files.save_record`.
        """
        save_history(self, self.history, Path(path), overwrite=overwrite, more=more)

    def _sized(
        self, cameras: Cameras | Sequence[int] | None, height: int | None, width: int | None
    ) -> SizedCameras:
        """The cameras of an argument, and the size of their pictures."""
        if not isinstance(cameras, Cameras):
            return resize_cameras(self._input_cameras(cameras), height, width)
        height = self.height if height is None else height
        width = self.width if width is None else width
        check_picture_size(height, width)
        return SizedCameras(cameras, height, width)

    def _input_cameras(self, views: Sequence[int] | None) -> SizedCameras:
        if not self.views:
            raise ValueError(
                "this scene was imported and has no input views: give cameras "
                "(instok3d.scene.paths.orbit; on the command line --path orbit)"
            )
        indices = list(range(len(self.views)) if views is None else views)
        if any(not 0 <= index < len(self.views) for index in indices):
            raise ValueError(f"views must lie in 0..{len(self.views) - 1}, got {indices}")
        return SizedCameras(self.cameras.views(indices), self.height, self.width)

    @torch.no_grad()
    def _id_maps(
        self, gaussians: Gaussians, cameras: Cameras, height: int, width: int
    ) -> Int[Tensor, "view {height} {width}"]:
        """View by view: the maps of all groups in all views together could fill the memory."""
        num_columns = self.tokens.assignment.shape[1]
        refuse_beyond(
            MAP_BYTES * min(num_columns, COLUMNS) * height * width,
            what=f"object ids of pictures of {width} x {height}",
            device=gaussians.means.device,
            remedy=lambda limit: "give a smaller height or width, or leave the ids out",
        )
        id_of_group = torch.zeros(num_columns, dtype=torch.long)
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
