"""What can be asked of a library: objects of many scenes, by words and by pictures.

Nothing but the library's own files is read: the scenes that its objects came from stay closed.
"""

import threading
from collections.abc import Iterable
from itertools import takewhile
from typing import Any

from instok3d.library.entries import Entry
from instok3d.library.folder import FolderLibrary
from instok3d.library.questions import picture_embedding, text_embedding
from instok3d.semantics.teacher import Teacher
from instok3d.service.parameters import Parameter
from instok3d.service.pictures import decoded_picture
from instok3d.service.tool import JPEG, Picture, Tool

SCENE = Parameter("scene", "string", "Name of the scene, as library_scenes has it.", required=True,
                  most=4000)  # fmt: skip
ID = Parameter("id", "integer", "Of an object, as answers have it.", required=True, least=0,
               most=2**31 - 1)  # fmt: skip
COUNT = Parameter("k", "integer", "At most so many objects.", 10, least=1, most=1000)
FIRST = Parameter("first", "integer", "Number of the first scene that is wanted, from 0.", 0,
                  least=0, most=10**9)  # fmt: skip
MOST_SCENES = Parameter("most", "integer", "At most so many scenes.", 100, least=1, most=1000)


class LibraryTools:
    """A library as it was when it was opened, for questions; answers come one at a time."""

    def __init__(self, library: FolderLibrary, teacher: Teacher | None) -> None:
        """Serve a library.

        Args:
            library: Any.
            teacher: Turns questions into embeddings of its encoder; None refuses questions.
        """
        self._library, self._teacher = library, teacher
        self._scenes = library.scenes()
        self._places = dict(zip(short_names(each.scene for each in self._scenes),
                                (each.scene for each in self._scenes), strict=True))  # fmt: skip
        self._names = {place: name for name, place in self._places.items()}
        self._alone = threading.Lock()

    def tools(self) -> tuple[Tool, ...]:
        """All tools, by name."""
        return (
            Tool("library_scenes", "The scenes of a library in the order of their names, with "
                 "numbers of objects, and the encoder of the library.",
                 (FIRST, MOST_SCENES), self.scenes),
            Tool("library_query", "The objects of all scenes of a library that are nearest to a "
                 "text, nearest first, with the cosine as score.",
                 (Parameter("text", "string", "What is looked for.", required=True, most=500),
                  COUNT), self.query),
            Tool("library_query_picture", "The objects of all scenes of a library that look most "
                 "like a picture of one thing.", (COUNT,), self.query_picture,
                 takes_picture=True),
            Tool("library_entry", "What a library has of one object: key, label, box.",
                 (SCENE, ID), self.entry),
            Tool("library_thumbnail", "A small picture (JPEG) of one object of a library.",
                 (SCENE, ID), self.thumbnail, picture_type=JPEG),
        )  # fmt: skip

    def scenes(self, first: int, most: int) -> dict[str, Any]:
        """Names and numbers."""
        encoder = self._library.encoder
        return {
            "scenes": [{"name": self._names[each.scene], "objects": each.objects}
                       for each in self._scenes[first : first + most]],
            "count": len(self._scenes),
            "objects": sum(each.objects for each in self._scenes),
            "encoder": None if encoder is None else encoder.name,
        }  # fmt: skip

    def query(self, text: str, k: int) -> dict[str, Any]:
        """Answers to words."""
        with self._alone:
            return self._matches(text_embedding(self._asked(), text), k)

    def query_picture(self, picture: bytes, k: int) -> dict[str, Any]:
        """Answers to a picture."""
        with self._alone:
            return self._matches(picture_embedding(self._asked(), decoded_picture(picture)), k)

    def entry(self, scene: str, id: int) -> dict[str, Any]:
        """One object."""
        return {"scene": scene, **self._entry(scene, id).to_json()}

    def thumbnail(self, scene: str, id: int) -> Picture:
        """Its picture, as it lies in the library."""
        return Picture(self._entry(scene, id).thumbnail, JPEG)

    def _asked(self) -> Teacher:
        if self._teacher is None:
            raise ValueError("this server has no encoder for questions to the library: start it "
                             "with --teacher")  # fmt: skip
        return self._teacher

    def _matches(self, embedding: Any, k: int) -> dict[str, Any]:
        found = self._library.query(embedding, k)
        return {"matches": [each.to_json() | {"scene": self._names[each.scene]} for each in found]}

    def _entry(self, scene: str, id: int) -> Entry:
        if scene not in self._places:
            raise KeyError(
                f"no scene {scene[:80]!r} in the library; library_scenes has their names"
            )
        try:
            return self._library.entry(self._places[scene], id)
        except KeyError as error:
            raise KeyError(f"the scene {scene[:80]!r} has no object {id} in the library") from error


def short_names(places: Iterable[str]) -> list[str]:
    """Places of scenes without the folders that all of them share."""
    parts = [place.split("/") for place in places]
    levels = zip(*(each[:-1] for each in parts), strict=False)  # as deep as the shallowest place
    shared = sum(1 for _ in takewhile(lambda names: len(set(names)) == 1, levels))
    return ["/".join(each[shared:]) for each in parts]
