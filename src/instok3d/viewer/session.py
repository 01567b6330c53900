"""What a person at the viewer has before them: a scene, what is selected, what can be inserted."""

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.moving import Point, Quaternion, Similarity
from instok3d.scene.edits.arguments import Number
from instok3d.scene.neighbours import Neighbour
from instok3d.scene.objects import SceneObject
from instok3d.scene.query import SceneQueries
from instok3d.scene.scene import Scene
from instok3d.semantics.query.encoder import QueryEncoder
from instok3d.viewer.folder import SceneFolder
from instok3d.viewer.picking import Picked, pick

MOST = 8
"""Scenes that can be added to insert from, since they stay in memory."""


@dataclass(frozen=True)
class Shown:
    """What the picture and the list show, all of it from one moment."""

    scene: Scene
    selected: frozenset[int] = frozenset()
    """Ids of objects of the scene."""
    instance_colors: bool = False
    """Each object in its own colour instead of the photos'."""
    place: Picked | None = None
    """What was clicked last, and where: there inserted objects stand."""


class Session:
    """The state of a viewer, without any browser.

    Edits are those of `Scene`, so that its log is the stack of undo and redo. With a folder each
    edit is in its log before this state changes, so that nothing is lost when the program ends;
    an edit that cannot be kept is not done.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        folder: SceneFolder | None = None,
        others: Mapping[str, Scene] = MappingProxyType({}),
        encoder: QueryEncoder | None = None,
    ) -> None:
        """Begin with nothing selected.

        Args:
            scene: What is shown.
            folder: Keeps the edits; None keeps them in memory alone.
            others: Scenes whose objects can be inserted, by name.
            encoder: Of the scene's semantics, for `search`; None: there is none.
        """
        self._encoder = encoder
        self._shown = Shown(scene)
        self._folder = folder
        self._lock = threading.RLock()
        self._neighbours: tuple[Scene | None, dict[int, tuple[Neighbour, ...]]] = None, {}
        self.others = dict(others)
        self._num_added = 0

    @property
    def shown(self) -> Shown:
        """What is to be seen now."""
        return self._shown

    @property
    def scene(self) -> Scene:
        """The scene with the edits done."""
        return self._shown.scene

    @property
    def selected(self) -> tuple[SceneObject, ...]:
        """The selected objects, in the order of the scene."""
        shown = self._shown
        return tuple(item for item in shown.scene.objects if item.id in shown.selected)

    @property
    def has_folder(self) -> bool:
        """Whether the scene came from a folder."""
        return self._folder is not None

    @property
    def can_undo(self) -> bool:
        """Whether an edit is there to be undone."""
        history = self.scene.history
        return history is not None and bool(history.edits)

    @property
    def can_redo(self) -> bool:
        """Whether an undone edit is there to be done again."""
        history = self.scene.history
        return history is not None and bool(history.undone)

    def select(self, *objects: int | str, add: bool = False) -> None:
        """Select objects instead of those that are, or besides them.

        Raises:
            KeyError: The scene has no such object.
        """
        with self._lock:
            ids = {self.scene.object(which).id for which in objects}
            before = self._shown.selected if add else frozenset()
            self._shown = replace(self._shown, selected=before | ids)

    def toggle(self, which: int | str) -> None:
        """Select an object besides those that are, or no longer.

        Raises:
            KeyError: The scene has no such object.
        """
        with self._lock:
            selected = self._shown.selected ^ {self.scene.object(which).id}
            self._shown = replace(self._shown, selected=selected)

    @property
    def can_search(self) -> bool:
        """Whether objects can be found by words."""
        return self._encoder is not None

    def search(self, text: str) -> str:
        """Select the objects that a text means; what was understood and found, in words.

        Raises:
            KeyError: None is there.
            ValueError: The text is not understood, or there is no encoder.
        """
        if self._encoder is None:
            raise ValueError("this scene has no semantics: nothing can be searched for in it")
        with self._lock:
            answers = SceneQueries(self.scene, self._encoder).text(text)
            if not answers.present:
                raise KeyError(f"{text!r} is not present in this scene{answers.closest_words()}")
            ids = [answer.object.id for answer in answers]
            self.select(*ids if answers.several else ids[:1])
        return f"{answers.understood}: {answers.words()}"

    def click(
        self,
        cam_from_world: Float[Tensor, "4 4"],
        intrinsics: Float[Tensor, "3 3"],
        height: int,
        width: int,
        pixel: tuple[float, float],
        *,
        add: bool = False,
    ) -> Picked:
        """Select the object that a pixel shows, and remember the place.

        Args:
            cam_from_world: Of the camera.
            intrinsics: For pictures of this size.
            height: Of the picture, pixels.
            width: Likewise.
            pixel: x, y.
            add: Keep what is selected, and take out what is clicked again.
        """
        with self._lock:
            found = pick(self.scene, cam_from_world, intrinsics, height, width, pixel)
            hit = frozenset({found.object} if found.object else ())
            selected = self._shown.selected ^ hit if add else hit
            self._shown = replace(self._shown, selected=selected, place=found)
            return found

    def color_instances(self, on: bool) -> None:
        """Show each object in its own colour, or in the photos'."""
        with self._lock:
            self._shown = replace(self._shown, instance_colors=on)

    def edit(self, operation: Callable[[Scene], Scene]) -> None:
        """Do one edit. New objects are selected, and those that went no longer are.

        Raises:
            KeyError, ValueError: It cannot be done; all is as it was.
            OSError: The folder does not keep it; all is as it was.
        """
        with self._lock:
            before, after = self.scene, operation(self.scene)
            if self._folder is not None:
                self._folder.keep(after)
            ids = {item.id for item in after.objects}
            new = ids - {item.id for item in before.objects}
            selected = frozenset(new or self._shown.selected & ids)
            self._shown = replace(self._shown, scene=after, selected=selected)

    def remove(self, *, fill: bool = False) -> None:
        """Take the selected objects away, with the haloes at their rims.

        Args:
            fill: Extend floors, walls and table tops into the hole, which is an invention.

        Raises:
            ValueError: Nothing is selected, or a hole is to be filled that no photo shows.
        """
        ids, plane = self._wanted(1), "plane" if fill else None
        self.edit(lambda scene: scene.remove(*ids, claim=bool(scene.views), fill=plane))

    def keep_alone(self) -> None:
        """Take everything else away."""
        ids = self._wanted(1)
        self.edit(lambda scene: scene.only(*ids))

    def hide(self) -> None:
        """Hide the selected objects."""
        ids = self._wanted(1)
        self.edit(lambda scene: scene.hide(*ids))

    def show(self) -> None:
        """Show the selected objects again."""
        ids = self._wanted(1)
        self.edit(lambda scene: scene.show(*ids))

    def merge(self) -> None:
        """Make one object of the selected ones: the largest keeps its id and names."""
        largest_first = sorted(self.selected, key=lambda item: -item.num_gaussians)
        self._wanted(2)
        self.edit(lambda scene: scene.merge(*(item.id for item in largest_first)))

    def touching(self) -> dict[str, int]:
        """The neighbours of the selected object, ids by words for a list to choose from.

        Those along most of its border come first; none where not exactly one is selected. The
        first call after an edit renders the input views, which takes a moment.
        """
        scene, selected = self.scene, self.selected
        if len(selected) != 1:
            return {}
        with self._lock:
            if self._neighbours[0] is not scene:
                self._neighbours = scene, scene.neighbours()
            found = self._neighbours[1][selected[0].id]
        return {f"{scene.object(each.id).key} ({each.share:.0%} of the border)": each.id
                for each in found}  # fmt: skip

    def merge_with(self, neighbour: int | None) -> None:
        """Join the selected object and another one; the selected one keeps its id and names.

        Raises:
            ValueError: No object is selected, or more than one, or it touches no other.
        """
        which = self._one()
        if neighbour is None:
            raise ValueError(
                f"{self.scene.object(which).key} touches no other object in the photos"
            )
        self.edit(lambda scene: scene.merge(which, neighbour))

    def rename(self, label: str) -> None:
        """Give the selected object a label."""
        which = self._one()
        self.edit(lambda scene: scene.rename(which, label))

    def split(self) -> None:
        """Make objects of the connected pieces of the selected one."""
        which = self._one()
        self.edit(lambda scene: scene.split(which))

    def move(self, which: int, motion: Similarity) -> None:
        """Move, turn and scale an object."""
        axis, angle_deg = axis_and_angle(motion.quat_wxyz)
        by = motion.translation
        self.edit(
            lambda scene: scene.move(
                which, by, yaw=angle_deg, scale=motion.scale, axis=axis, about=(0.0, 0.0, 0.0)
            )
        )

    def turn(self, yaw: Number) -> None:
        """Turn the selected objects about up, each on its base; degrees."""
        for which in self._wanted(1):
            self.edit(lambda scene, which=which: scene.move(which, yaw=yaw))

    def duplicate(self) -> None:
        """A second one of the selected object, beside it by the width of its box."""
        item = self.scene.object(self._one())
        by = [0.0, 0.0, 0.0]
        sizes = [high - low for low, high in zip(item.aabb.min, item.aabb.max, strict=True)]
        level = min(range(3), key=lambda axis: abs(self.scene.vertical.up[axis]))
        by[level] = sizes[level]
        self.edit(lambda scene: scene.duplicate(item.id, by))

    def insert(self, other: str, which: int | str, *, scale: Number | None = None) -> None:
        """Put an object of another scene where the picture was clicked last.

        It stands on the object that was clicked there, if one was.

        Raises:
            KeyError: There is no such scene or object.
            ValueError: Nothing was clicked, or the object there has no surface to stand on.
        """
        if other not in self.others:
            known = ", ".join(self.others) or "none"
            raise KeyError(f"no scene {other!r} to insert from; there are: {known}")
        place = self._shown.place
        if place is None or place.point is None:
            raise ValueError("click in the picture where it is to stand, on a floor or a table")
        known_ids = {item.id for item in self.scene.objects}
        on = place.object if place.object in known_ids else None
        source = self.others[other]
        self.edit(lambda scene: scene.insert(source, which, place.point, on=on, scale=scale))

    def add_other(self, name: str, scene: Scene) -> str:
        """A scene to insert from besides the others; the name that it gets.

        Raises:
            ValueError: It has no objects, or as many as there may be were added before.
        """
        with self._lock:
            if not scene.objects:
                raise ValueError(f"{name} has no objects that could be inserted")
            if self._num_added >= MOST:
                raise ValueError(f"{MOST} files were added before: start the viewer anew")
            count, free = 1, name
            while free in self.others:
                count += 1
                free = f"{name} ({count})"
            self.others[free] = scene
            self._num_added += 1
            return free

    def undo(self) -> None:
        """Take the last edit back."""
        self.edit(Scene.undo)

    def redo(self) -> None:
        """Do the edit again that was undone last."""
        self.edit(Scene.redo)

    def save_as(self, name: str) -> Path:
        """Write the scene with its log beside the folder it came from; its path.

        Raises:
            FileExistsError: Something of this name is there.
            ValueError: There is no folder, or the name is no plain name that ends in .itk.
        """
        if self._folder is None:
            raise ValueError("this scene came from no folder: use scene.save() in Python")
        return self._folder.save_beside(self.scene, name)

    def _wanted(self, least: int) -> tuple[int, ...]:
        """Ids of the selected objects, at least so many."""
        ids = tuple(item.id for item in self.selected)
        if len(ids) < least:
            what = "an object" if least == 1 else f"{least} objects or more"
            raise ValueError(f"select {what} first: click in the picture, or in the list")
        return ids

    def _one(self) -> int:
        first, *more = self._wanted(1)
        if more:
            raise ValueError(f"select one object alone: {1 + len(more)} are selected")
        return first


def axis_and_angle(quat_wxyz: Quaternion) -> tuple[Point, float]:
    """Unit axis and degrees in [0, 360) of a rotation; any axis where it turns nothing."""
    w, x, y, z = quat_wxyz
    length = math.hypot(x, y, z)
    if length < 1e-12:
        return (0.0, 0.0, 1.0), 0.0
    return (x / length, y / length, z / length), math.degrees(2 * math.atan2(length, w)) % 360
