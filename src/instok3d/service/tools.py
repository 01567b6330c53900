"""What can be asked of opened scenes."""

import io
import threading
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from PIL import Image

from instok3d.pictures import color_picture, id_picture
from instok3d.scene.changes.differences import find_differences
from instok3d.scene.description import describe
from instok3d.scene.goals import find_goal
from instok3d.scene.object_list import objects_document
from instok3d.scene.objects import find_object
from instok3d.scene.paths import orbit
from instok3d.scene.picture_size import SizedCameras, resize_cameras
from instok3d.scene.query import Answers, SceneQueries
from instok3d.scene.scene import Scene
from instok3d.semantics.query.shipped import find_encoder
from instok3d.service.parameters import Parameter
from instok3d.service.pictures import decoded_picture
from instok3d.service.tool import PNG, Picture, Tool

MOST_PIXELS = 1024
"""Longest side of a picture."""
SCENE = Parameter("scene", "string", "Name of the scene, as list_scenes has it; the first one if "
                  "left out.", most=200)  # fmt: skip
OBJECT = Parameter("object", "string", "Id, key or label of an object, such as 3 or chair#3.",
                   required=True, most=120)  # fmt: skip
MOST_ANSWERS = Parameter("k", "integer", "At most so many objects.", 5, least=1, most=100)


class Rooms:
    """Opened scenes by name. Answers come one at a time: each uses all cores."""

    def __init__(self, scenes: Mapping[str, Scene]) -> None:
        """Serve these scenes and nothing else.

        Raises:
            ValueError: There is none.
        """
        if not scenes:
            raise ValueError("no scene to serve: give a scene folder, such as room.itk")
        self._scenes = dict(scenes)
        self._alone = threading.Lock()
        self._queries: dict[str, SceneQueries] = {}

    def tools(self) -> tuple[Tool, ...]:
        """All tools, by name."""
        return (
            Tool("list_scenes", "The scenes that are served, with numbers of objects and photos.",
                 (), self.list_scenes),
            Tool("describe", "A short text about a scene, and the same as data: objects, sizes, "
                 "places, colours, what stands where.",
                 (SCENE, Parameter("most", "integer", "At most so many objects, the largest ones.",
                                   60, least=1, most=1000)), self.describe),
            Tool("list_objects", "The objects of a scene: keys, boxes, sizes, where they are seen.",
                 (SCENE,), self.list_objects),
            Tool("get_object", "One object of a scene, with its masks in the photos.",
                 (SCENE, OBJECT), self.get_object),
            Tool("query", "The objects that words mean, such as 'the red chair next to the "
                 "window'; or that nothing is present. Needs a scene with semantics.",
                 (SCENE, Parameter("text", "string", "What is looked for.", required=True,
                                   most=500),
                  MOST_ANSWERS), self.query),
            Tool("query_picture", "The objects that look like a picture of one thing, or that "
                 "nothing is present. Needs a scene with semantics.", (SCENE, MOST_ANSWERS),
                 self.query_picture, takes_picture=True),
            Tool("render", "A picture (PNG) of a scene, from one of its photos' cameras or from "
                 "around.",
                 (SCENE, Parameter("view", "integer", "Number of a photo, from 0; or of one of 8 "
                                   "cameras around the scene.", 0, least=0, most=10000),
                  Parameter("around", "boolean", "Look from around, not from a photo.", False),
                  Parameter("only", "string", "Id, key or label of the only object to draw.",
                            most=120),
                  Parameter("height", "integer", "Of the picture, pixels.", 256, least=16,
                            most=MOST_PIXELS),
                  Parameter("width", "integer", "Likewise; if left out the photos' shape is kept.",
                            least=16, most=MOST_PIXELS),
                  Parameter("show", "string", "Colours, or each object in a colour of its own.",
                            "colors", choices=("colors", "objects"))), self.render,
                 picture_type=PNG),
            Tool("goal", "A free spot on the floor beside an object and the direction to face it, "
                 "computed from boxes: a proposal for a planner.",
                 (SCENE, OBJECT, Parameter("radius", "number", "Of the robot, scene units.",
                                           least=1e-6, most=1e9)), self.goal),
            Tool("difference", "What moved, is gone or new between two scenes of one room.",
                 (Parameter("before", "string", "Name of the first scene.", required=True,
                            most=200),
                  Parameter("after", "string", "Name of the second scene.", required=True,
                            most=200)), self.difference),
        )  # fmt: skip

    def list_scenes(self) -> dict[str, Any]:
        """Names and numbers."""
        return {"scenes": [
            {"name": name, "objects": len(scene.objects), "photos": len(scene.views),
             "units": scene.units, "semantics": sorted(scene.semantics)}
            for name, scene in self._scenes.items()
        ]}  # fmt: skip

    def describe(self, scene: str | None, most: int) -> dict[str, Any]:
        """See `instok3d.scene.description`."""
        with self._alone:
            return describe(self._scene(scene)[1], most=most).to_json()

    def list_objects(self, scene: str | None) -> dict[str, Any]:
        """objects.json without masks."""
        value = self._document(scene)
        for each in value["objects"]:
            for seen in each["seen"]:
                del seen["mask"]
        return value

    def get_object(self, scene: str | None, object: str) -> dict[str, Any]:
        """An entry of objects.json."""
        item = _object(self._scene(scene)[1], object)
        return next(each for each in self._document(scene)["objects"] if each["id"] == item.id)

    def query(self, scene: str | None, text: str, k: int) -> dict[str, Any]:
        """Answers to words."""
        with self._alone:
            return _answers(self._asked(scene).text(text, k))

    def query_picture(self, picture: bytes, scene: str | None, k: int) -> dict[str, Any]:
        """Answers to a picture."""
        with self._alone:
            asked = self._asked(scene)
            return _answers(asked.picture(decoded_picture(picture), k))

    def render(
        self, scene: str | None, view: int, around: bool, only: str | None, height: int,
        width: int | None, show: str,
    ) -> Picture:  # fmt: skip
        """A PNG."""
        chosen = self._scene(scene)[1]
        part = None if only is None else _object(chosen, only).id
        count = AROUND if around else len(chosen.views)
        if not view < count:
            what = f"its views are 0 to {count - 1}" if count else "it has none: look from around"
            raise KeyError(f"no view {view} of this scene; {what}")
        with self._alone, torch.no_grad(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pictures of another shape than the photos
            sized = SizedCameras(
                orbit(chosen, AROUND) if around else chosen.cameras, chosen.height, chosen.width
            )
            sized = resize_cameras(replace(sized, cameras=sized.cameras.view(view)), height, width)
            drawn = chosen.render(
                sized.cameras, sized.height, sized.width, only=part, ids=show == "objects"
            )
            shown = color_picture(drawn.colors) if drawn.ids is None else id_picture(drawn.ids)
        stream = io.BytesIO()
        Image.fromarray(shown[0]).save(stream, "PNG")
        return Picture(stream.getvalue())

    def goal(self, scene: str | None, object: str, radius: float | None) -> dict[str, Any]:
        """See `instok3d.scene.goals`."""
        chosen = self._scene(scene)[1]
        item = _object(chosen, object)
        with self._alone:
            found = find_goal(chosen, item, radius)
        return {"object": item.key, "units": chosen.units, "position": list(found.position),
                "facing": list(found.facing), "gap": found.gap, "radius": found.radius}  # fmt: skip

    def difference(self, before: str, after: str) -> dict[str, Any]:
        """See `instok3d.scene.changes.differences`."""
        first, second = self._scene(before)[1], self._scene(after)[1]
        with self._alone:
            return find_differences(first, second).to_json()

    def _asked(self, scene: str | None) -> SceneQueries:
        name, chosen = self._scene(scene)
        if name not in self._queries:
            self._queries[name] = SceneQueries(chosen, find_encoder(chosen.semantics))
        return self._queries[name]

    def _scene(self, name: str | None) -> tuple[str, Scene]:
        if name is None:
            return next(iter(self._scenes.items()))
        if name not in self._scenes:
            raise KeyError(f"no scene {name[:80]!r}; there are: {', '.join(self._scenes)}")
        return name, self._scenes[name]

    def _document(self, name: str | None) -> dict[str, Any]:
        with self._alone:
            return objects_document(self._scene(name)[1])


AROUND = 8
"""Cameras around a scene."""


def _object(scene: Scene, which: str) -> Any:
    return find_object(scene.objects, int(which) if which.isdecimal() else which)


def _answers(found: Answers) -> dict[str, Any]:
    return {
        "understood": found.understood,
        "present": found.present,
        "several": found.several,
        "encoder": found.encoder,
        "threshold": found.threshold,
        "answers": [each.to_json() for each in found],
        "closest": [each.to_json() for each in found.ranked[:3]] if not found.present else [],
    }
