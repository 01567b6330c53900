"""What can be done with the objects of a scene; each edit gives a new scene."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import torch

from instok3d.geometry.moving import NO_TURN, Similarity, quat_about
from instok3d.scene.edits.arguments import Number, degrees, factor, point
from instok3d.scene.edits.arguments import color as checked_color
from instok3d.scene.edits.claim import claimed_rows
from instok3d.scene.edits.fill import plane_fill
from instok3d.scene.edits.history import History
from instok3d.scene.edits.holes import holes_after
from instok3d.scene.edits.operations import (
    Duplicate,
    Edit,
    Hide,
    Insert,
    Merge,
    Move,
    Only,
    Recolor,
    Remove,
    Rename,
    Show,
    Split,
    Up,
)
from instok3d.scene.edits.ownership import Part, part_of
from instok3d.scene.edits.pieces import connected_pieces, gap_of, inside_box
from instok3d.scene.edits.placing import (
    base_of_object,
    into_world,
    scale_between,
    standing_on,
    upright_between,
)
from instok3d.scene.edits.scene_objects import carried, object_of
from instok3d.scene.files import gaussians_sha256
from instok3d.scene.names import check_label
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import SceneRecord
from instok3d.scene.run_lengths import RunLengths
from instok3d.scene.vertical import given_up

AnyScene = TypeVar("AnyScene", bound="EditableScene")
Which = int | str


@dataclass(frozen=True, repr=False)
class EditableScene(SceneRecord):
    """Edits. Objects are named by id, key or label; nothing else of the scene is touched.

    Boxes, centroids, counts and ranges are right at once; where an object is seen is found when it
    is first asked for. `instok3d.scene.edits.ownership` says what stays true.
    """

    history: History | None = None
    """What was edited, by which it can be undone; None before the first edit of a new scene."""

    @property
    def edits(self) -> tuple[str, ...]:
        """What was edited, in words."""
        return self.provenance.edits

    def only(self: AnyScene, *objects: Which) -> AnyScene:
        """Some objects alone: the others go, and the rest that belongs to none.

        Raises:
            KeyError: The scene has no such object.
        """
        return self._edited(Only(self._ids(objects)))

    def remove(
        self: AnyScene,
        *objects: Which,
        claim: bool = False,
        fill: str | None = None,
    ) -> AnyScene:
        """The scene without some objects; what no photo saw behind them is not there.

        Args:
            objects: What goes.
            claim: Take Gaussians of others along that show the object more than anything else, as
                haloes at its rim do, and write the hole in the input views into the log. Renders
                the input views.
            fill: "plane" extends floors, walls and table tops at the rim of the hole into it: an
                invention, which the provenance says. Renders the input views.

        Raises:
            KeyError: The scene has no such object.
            ValueError: A fill of another kind, or of a scene without input views, whose hole no
                picture shows.
        """
        ids = self._ids(objects)
        if fill is not None and (fill != "plane" or not self.views):
            why = f"{fill!r} is none" if self.views else "the scene has no input views"
            raise ValueError(f"fill must be 'plane', in a scene with input views: {why}")
        if not claim and fill is None:
            return self._edited(Remove(ids, torch.zeros(0, dtype=torch.long)))
        claimed = claimed_rows(self, ids) if claim else torch.zeros(0, dtype=torch.long)
        removal = Remove(ids, claimed)
        dropped = removal.dropped_rows(self)
        if fill is None:
            invented, hole = None, holes_after(self, dropped)
        else:
            invented, hole = plane_fill(self, dropped, removal.apply(self))
        if invented is not None and not len(invented.means):
            warnings.warn("no flat surface is seen around the hole: nothing fills it", stacklevel=2)
            invented = None
        masks = tuple(map(RunLengths.of, hole))
        return self._edited(replace(removal, hole=masks, invented=invented))

    def move(
        self: AnyScene,
        which: Which,
        by: Sequence[Number] = (0.0, 0.0, 0.0),
        *,
        yaw: Number = 0.0,
        scale: Number = 1.0,
        axis: Sequence[Number] | None = None,
        about: Sequence[Number] | None = None,
    ) -> AnyScene:
        """An object moved, turned, scaled, its colours turned with it.

        Args:
            which: The object.
            by: How far, along the axes of the world, scene units.
            yaw: Degrees about the scene's up, counter-clockwise seen from above.
            scale: Of its lengths, above 0.
            axis: Turn about this direction instead of up.
            about: The point that turn and scale leave in place; the middle of its base if None.

        Raises:
            KeyError: The scene has no such object.
            ValueError: A number is not finite or out of range.
        """
        motion = self._motion(which, by, yaw=yaw, scale=scale, axis=axis, about=about)
        return self._edited(Move(object_of(self, which).id, motion))

    def duplicate(
        self: AnyScene,
        which: Which,
        by: Sequence[Number],
        *,
        yaw: Number = 0.0,
        scale: Number = 1.0,
    ) -> AnyScene:
        """A second one of an object, as `move` would have moved it; the last of `objects`.

        Raises:
            KeyError: The scene has no such object.
            ValueError: A number is not finite or out of range.
        """
        motion = self._motion(which, by, yaw=yaw, scale=scale)
        return self._edited(Duplicate(object_of(self, which).id, motion))

    def insert(
        self: AnyScene,
        other: SceneRecord,
        which: Which,
        at: Sequence[Number] | None = None,
        *,
        on: Which | None = None,
        yaw: Number = 0.0,
        scale: Number | None = None,
    ) -> AnyScene:
        """An object of another scene, upright; the last of `objects`.

        Args:
            other: The other scene, which stays as it is.
            which: An object of it.
            at: Where the middle of its base comes to be, scene units.
            on: An object of this scene, such as a floor or a table, on which it stands: the height
                of `at` does not matter then, and None is the middle of that object.
            yaw: Degrees about this scene's up, counter-clockwise seen from above.
            scale: Of lengths. None takes 1 where both scenes are in metres, and otherwise takes
                both to be equally large, with a warning.

        Raises:
            KeyError: One of the scenes has no such object.
            ValueError: Neither `at` nor `on`, numbers that are not finite, or nothing to stand on.
        """
        item = object_of(other, which)
        length = scale_between(other, self) if scale is None else factor(scale, "scale")
        place = self._place(at, on, 0.5 * length * max(item.obb.size))
        motion = into_world(
            base_of_object(other, item), upright_between(other, self), self.vertical.up, place,
            scale=length, yaw_rad=degrees(yaw, "yaw"),
        )  # fmt: skip
        part = self._fitting(carried(part_of(other, item), motion), other)
        origin = f"{item.key} of the scene {gaussians_sha256(other.gaussians)}"
        return self._edited(
            Insert(part, item.label, item.confidence, origin, item.label_source, item.label_score)
        )

    def recolor(self: AnyScene, which: Which, color: str | Sequence[Number]) -> AnyScene:
        """An object in another colour, "red", "#rrggbb" or three numbers; its shading stays.

        Raises:
            KeyError: The scene has no such object.
            ValueError: It is no colour.
        """
        return self._edited(Recolor(object_of(self, which).id, checked_color(color)))

    def merge(self: AnyScene, *objects: Which) -> AnyScene:
        """Two or more objects as one, which keeps the id and the names of the first.

        Raises:
            KeyError: The scene has no such object.
            ValueError: Fewer than two different objects.
        """
        return self._edited(Merge(self._ids(objects)))

    def split(
        self: AnyScene,
        which: Which,
        *,
        box: tuple[Sequence[Number], Sequence[Number]] | None = None,
        gap: Number | None = None,
    ) -> AnyScene:
        """An object as several: its connected pieces, the largest of which stays the object.

        The others are the last of `objects`, the largest first.

        Args:
            which: The object.
            box: Lowest and highest x y z: the anchors in this box become the new object instead.
            gap: Pieces that are nearer to each other are connected, scene units; a share of the
                object's size if None.

        Raises:
            KeyError: The scene has no such object.
            ValueError: It is one piece, or the box holds none or all of it.
        """
        item = object_of(self, which)
        start, count = item.gaussian_range
        if box is not None:
            low, high = point(box[0], "box"), point(box[1], "box")
            chosen = inside_box(self, item, low, high)
            if chosen.all() or not chosen.any():
                share = "all" if chosen.any() else "none"
                raise ValueError(
                    f"the box holds {share} of {item.key}, which reaches from {item.aabb.min} to "
                    f"{item.aabb.max}: give a box that holds a part of it"
                )
            return self._edited(Split(item.id, chosen.nonzero()[:, 0]))
        own = self.gaussians.rows(slice(start, start + count))
        apart = gap_of(item) if gap is None else factor(gap, "gap")
        pieces = connected_pieces(own, apart)
        if not pieces.any():
            raise ValueError(
                f"{item.key} is one connected piece (gaps below {apart:.3g} count as none): give a "
                "box or a smaller gap"
            )
        scene = self
        for piece in range(1, int(pieces.max()) + 1):
            # What stays keeps its order, so that rows are counted without those that have gone.
            left = pieces[(pieces == 0) | (pieces >= piece)]
            scene = scene._edited(Split(item.id, (left == piece).nonzero()[:, 0]))
        return scene

    def rename(self: AnyScene, which: Which, label: str) -> AnyScene:
        """An object with a label, such as "red chair", and the key "red chair#3".

        Raises:
            KeyError: The scene has no such object.
            ValueError: The label is none (`check_label`).
        """
        return self._edited(Rename(object_of(self, which).id, check_label(label)))

    def hide(self: AnyScene, *objects: Which) -> AnyScene:
        """The scene with some objects not drawn and not exported.

        Raises:
            KeyError: The scene has no such object.
        """
        return self._edited(Hide(self._ids(objects)))

    def show(self: AnyScene, *objects: Which) -> AnyScene:
        """The scene with some objects drawn again.

        Raises:
            KeyError: The scene has no such object.
        """
        return self._edited(Show(self._ids(objects)))

    def with_up(self: AnyScene, direction: str | Sequence[str | Number]) -> AnyScene:
        """The scene with another up, for turns, orbits and exports; nothing in it moves.

        Args:
            direction: An axis, such as "z" or "-y", or three numbers.

        Raises:
            ValueError: It is neither.
        """
        return self._edited(Up(given_up(direction).up))

    def undo(self: AnyScene) -> AnyScene:
        """The scene before the last edit, bit for bit.

        Raises:
            ValueError: There is none, or the scene was made anew since (refined, for example).
        """
        return self._at(self._known_history().undo())

    def redo(self: AnyScene) -> AnyScene:
        """The scene with the edit that was undone last.

        Raises:
            ValueError: There is none.
        """
        return self._at(self._known_history().redo())

    def _edited(self: AnyScene, edit: Edit) -> AnyScene:
        return self._at(self._known_history().done(edit))

    def _at(self: AnyScene, history: History) -> AnyScene:
        data: dict[str, Any] = {
            field.name: getattr(history.current, field.name) for field in fields(SceneRecord)
        }
        return replace(self, **data, history=history)

    def _known_history(self) -> History:
        """The history, or a new one where this scene is not what that gives."""
        if self.history is not None and self.history.gives(self):
            return self.history
        return History.begin(self, gaussians_sha256(self.gaussians))

    def _ids(self, objects: Sequence[Which]) -> tuple[int, ...]:
        if not objects:
            raise ValueError("name at least one object, by id, key or label")
        return tuple(dict.fromkeys(object_of(self, which).id for which in objects))

    def _motion(
        self,
        which: Which,
        by: Sequence[Number],
        *,
        yaw: Number,
        scale: Number,
        axis: Sequence[Number] | None = None,
        about: Sequence[Number] | None = None,
    ) -> Similarity:
        item, angle_rad, length = (
            object_of(self, which),
            degrees(yaw, "yaw"),
            factor(scale, "scale"),
        )
        moved = point(by, "by")
        if angle_rad == 0 and length == 1:
            return Similarity(moved)
        pivot = base_of_object(self, item) if about is None else point(about, "about")
        direction = torch.tensor(
            self.vertical.up if axis is None else point(axis, "axis"), dtype=torch.float64
        )
        if not float(direction.norm()) > 0:
            raise ValueError(f"axis must have a length above 0, got {axis}")
        turn = quat_about((direction / direction.norm()).tolist(), angle_rad)
        return Similarity.about(
            pivot, quat_wxyz=NO_TURN if angle_rad == 0 else turn, scale=length, by=moved
        )

    def _place(
        self, at: Sequence[Number] | None, on: Which | None, radius: float
    ) -> tuple[float, float, float]:
        place = None if at is None else point(at, "at")
        if on is None:
            if place is None:
                raise ValueError(
                    "say where the object is to stand: at a point, on an object, or both"
                )
            return place
        surface: SceneObject = object_of(self, on)
        return standing_on(self, surface, place or surface.obb.center, radius)

    def _fitting(self, part: Part, other: SceneRecord) -> Part:
        """The part with tokens of this scene's kind: zeros where another model made them."""
        channels = self.tokens.anchors.shape[1]
        same = self.provenance.model_sha256 == other.provenance.model_sha256
        if same and part.anchors.shape[1] == channels:
            return part
        return replace(
            part, anchors=torch.zeros(len(part.anchors), channels), group=torch.zeros(channels)
        )
