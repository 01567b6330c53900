"""The pieces of a room: what a generator makes, or a model in its place."""

from collections.abc import Callable

from instok3d.rooms.catalogues.models import FurnitureCatalogue
from instok3d.rooms.materials import Maker
from instok3d.rooms.objects import REGISTRY, Furniture
from instok3d.rooms.seeding import Streams


class Pieces:
    """Makes objects one after the other, each from a stream of its own.

    Args:
        purpose: First part of the streams' keys.
        maker: What draws the numbers and materials of one object, by the key of its stream.
        streams: Of the room.
        models: Some of the objects are models of this catalogue.
    """

    def __init__(
        self,
        purpose: str,
        maker: Callable[..., Maker],
        streams: Streams,
        models: FurnitureCatalogue | None = None,
    ):
        self.purpose, self.maker, self.streams, self.models = purpose, maker, streams, models
        self.count = 0

    def make(self, name: str) -> Furniture:
        """The next object, of the generator of this name or of a model like it."""
        self.count += 1
        if self.models is not None:
            stream = self.streams.child("model", self.purpose, name, self.count)
            if (model := self.models.draw(stream, name)) is not None:
                return model
        return REGISTRY[name](self.maker(self.purpose, name, self.count))
