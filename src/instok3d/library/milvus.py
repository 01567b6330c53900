"""A library on a Milvus server (`pip install 'instok3d[search]'`), for more than one disk holds.

Two collections: NAME with a row for each object, NAME_scenes with a row for each scene and one for
the library itself. Ids are made of the scene's place and the object's number, so that an addition
that was cut off is taken up by running it again. A scene counts once its row says that it is
complete, which is written last.
"""

import base64
import hashlib
import json
import os
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from jaxtyping import Float

from instok3d.library.entries import (
    Audit,
    Encoder,
    Entry,
    Match,
    SceneEntries,
    StoredScene,
    check_encoder,
)
from instok3d.reading import naming_damage, one_line, parse_json, text, whole_number

FORMAT, VERSION = "instok3d-library-milvus", 1
LIBRARY = "library"
"""Id of the row about the library itself; scenes have digests."""
BATCH = 500
"""Objects sent together."""
AT_ONCE = 10_000
"""Rows asked for together, within the server's limit."""
REMEDY = "make the library again from its scenes"
TOKEN = "INSTOK3D_MILVUS_TOKEN"
"""Environment variable with user:password or an API key, where the server asks for one."""
SCENE_LENGTH, INFO_LENGTH, THUMBNAIL_LENGTH = 16_384, 16_384, 65_535
"""Bytes of texts that a field takes."""


class MilvusLibrary:
    """A library on a Milvus server."""

    def __init__(self, client: Any, name: str, place: str) -> None:
        """Open a library, which may not be there yet.

        Args:
            client: A pymilvus.MilvusClient.
            name: Of the collection.
            place: Of the library, for messages.

        Raises:
            ValueError: It is damaged, or of a newer version.
        """
        self._client, self._name, self._place = client, name, place
        self._table = f"{name}_scenes"
        self.encoder: Encoder | None = None
        with naming_server(place):
            if client.has_collection(self._table):
                self.encoder = self._read_encoder()

    def scenes(self) -> list[StoredScene]:
        """All complete scenes, in the order of their places."""
        rows = [row for row in self._rows() if row["complete"]]
        return sorted(
            (StoredScene(row["scene"], row["objects"]) for row in rows), key=lambda one: one.scene
        )

    def query(self, embedding: Float[np.ndarray, " channel"], count: int) -> list[Match]:
        """The objects nearest to an embedding by cosine, nearest first.

        Raises:
            ValueError: The embedding is none, or the server refuses.
        """
        if self.encoder is None:
            return []
        if embedding.shape != (self.encoder.channels,) or not np.isfinite(embedding).all():
            raise ValueError(f"the query must be {self.encoder.channels} finite numbers")
        if not embedding.any():
            raise ValueError("the query is 0, which is like nothing")
        if count <= 0:
            return []
        if count > AT_ONCE:
            raise ValueError(f"a server finds at most {AT_ONCE} objects at once, not {count}")
        unfinished = [row["id"] for row in self._rows("complete == false")]
        with naming_server(self._place):
            found = self._client.search(
                self._name,
                data=[embedding.astype(np.float32).tolist()],
                limit=count,
                filter=f"scene_id not in {json.dumps(unfinished)}" if unfinished else "",
                output_fields=["scene", "object", "info", "thumbnail"],
            )[0]
        return [_match(each["entity"], float(each["distance"]), self._place) for each in found]

    def add(self, scene: str, entries: SceneEntries) -> None:
        """Add a scene, or put it in place of what was added from the same place.

        While that goes on the scene is in the library neither in its old nor in its new form.

        Raises:
            ValueError: Its encoder is not the library's, or the server refuses.
        """
        check_encoder(self.encoder, entries.encoder, self._place)
        if len(scene.encode(errors="replace")) > SCENE_LENGTH:
            raise ValueError(f"the place of the scene {scene[:60]}... is too long for a server")
        unit = entries.embeddings / np.linalg.norm(entries.embeddings, axis=1, keepdims=True)
        digest, revision = scene_id(scene), uuid.uuid4().hex
        rows = [
            {
                "id": f"{digest}-{item.id}",
                "scene_id": digest,
                "revision": revision,
                "scene": scene,
                "object": item.id,
                "info": _info(item),
                "thumbnail": base64.b64encode(item.thumbnail).decode(),
                "embedding": row.astype(np.float32).tolist(),
            }
            for item, row in zip(entries.objects, unit, strict=True)
        ]
        with naming_server(self._place):
            if self.encoder is None:
                self._create(entries.encoder)
            state = {"id": digest, "scene": scene, "objects": len(rows)}
            self._put([state | {"complete": False}])
            for place in range(0, len(rows), BATCH):
                self._client.upsert(self._name, data=rows[place : place + BATCH])
            self._client.delete(
                self._name, filter=f'scene_id == "{digest}" and revision != "{revision}"'
            )
            self._put([state | {"complete": True}])

    def remove(self, scenes: Sequence[str]) -> None:
        """Take scenes out.

        Raises:
            KeyError: One is not in the library; none is taken out then.
        """
        known = {row["scene"]: row for row in self._rows()}
        for scene in scenes:
            if scene not in known:
                raise KeyError(f"{self._place} has no scene {scene}: see `library list`")
        with naming_server(self._place):
            for scene in scenes:
                row = known[scene]
                self._put([row | {"complete": False}])
                self._client.delete(self._name, filter=f'scene_id == "{row["id"]}"')
                self._client.delete(self._table, ids=[row["id"]])

    def compact(self) -> None:
        """Ask the server to give back the room of what was taken out."""
        if self.encoder is not None:
            with naming_server(self._place):
                for name in (self._name, self._table):
                    self._client.compact(name)

    def verify(self) -> Audit:
        """Count the objects of each scene, and read all but their embeddings.

        Raises:
            ValueError: A scene has not as many objects as its row says, or a row is damaged.
        """
        objects = size = 0
        scenes = self.scenes()
        for each in scenes:
            found = 0
            wanted = f'scene_id == "{scene_id(each.scene)}"'
            for row in self._all(self._name, wanted, ["scene", "object", "info", "thumbnail"]):
                size += len(_match(row, 0.0, self._place).object.thumbnail)
                found += 1
            if found != each.objects:
                raise ValueError(
                    f"{self._place} is damaged: {each.scene} has {found} of {each.objects} "
                    "objects; add it again"
                )
            objects += found
        channels = 0 if self.encoder is None else self.encoder.channels
        return Audit(len(scenes), objects, size + 4 * channels * objects)

    def _create(self, encoder: Encoder) -> None:
        """Make the collections that are not there, and write down the encoder."""
        from pymilvus import DataType

        objects = [
            ("scene_id", DataType.VARCHAR, 64), ("revision", DataType.VARCHAR, 64),
            ("scene", DataType.VARCHAR, SCENE_LENGTH), ("object", DataType.INT64, None),
            ("info", DataType.VARCHAR, INFO_LENGTH),
            ("thumbnail", DataType.VARCHAR, THUMBNAIL_LENGTH),
        ]  # fmt: skip
        table = [
            ("scene", DataType.VARCHAR, SCENE_LENGTH), ("objects", DataType.INT64, None),
            ("complete", DataType.BOOL, None),
        ]  # fmt: skip
        self._collection(self._name, objects, "embedding", encoder.channels, "COSINE")
        self._collection(self._table, table, "nothing", 2, "L2")
        about = {"format": FORMAT, "version": VERSION, **vars(encoder)}
        self._put([{"id": LIBRARY, "scene": json.dumps(about), "objects": 0, "complete": False}])
        self.encoder = encoder

    def _collection(
        self,
        name: str,
        fields: Sequence[tuple[str, Any, int | None]],
        vector: str,
        channels: int,
        metric: str,
    ) -> None:
        """Make a collection, whose search is exact, if it is not there."""
        from pymilvus import DataType

        if self._client.has_collection(name):
            return
        schema = self._client.create_schema(auto_id=False, enable_dynamic_field=False)
        schema.add_field("id", DataType.VARCHAR, is_primary=True, max_length=128)
        for field, kind, length in fields:
            options = {} if length is None else {"max_length": length}
            schema.add_field(field, kind, **options)
        schema.add_field(vector, DataType.FLOAT_VECTOR, dim=channels)
        index = self._client.prepare_index_params()
        index.add_index(vector, index_type="FLAT", metric_type=metric)
        self._client.create_collection(
            name, schema=schema, index_params=index, consistency_level="Strong"
        )

    def _put(self, rows: Sequence[dict[str, Any]]) -> None:
        """Write rows of the table of scenes; the server wants a vector in each."""
        self._client.upsert(self._table, data=[{**row, "nothing": [0.0, 0.0]} for row in rows])

    def _rows(self, wanted: str = "") -> list[dict[str, Any]]:
        """Rows of scenes: all, complete or not, or those that the server finds to fit."""
        if self.encoder is None:
            return []
        fields = ["id", "scene", "objects", "complete"]
        scenes = f'id != "{LIBRARY}"'
        return list(self._all(self._table, f"{scenes} and {wanted}" if wanted else scenes, fields))

    def _all(self, name: str, wanted: str, fields: Sequence[str]) -> Iterator[dict[str, Any]]:
        """All rows of a collection that fit, however many."""
        with naming_server(self._place):
            pages = self._client.query_iterator(
                name, filter=wanted, output_fields=[*fields], batch_size=AT_ONCE
            )
            try:
                while rows := pages.next():
                    for row in rows:
                        yield {field: row[field] for field in fields}
            finally:
                pages.close()

    def _read_encoder(self) -> Encoder | None:
        rows = self._client.query(self._table, filter=f'id == "{LIBRARY}"', output_fields=["scene"])
        if not rows:  # it was cut off before anything was added
            return None
        with naming_damage(self._place, REMEDY):
            value = parse_json(rows[0]["scene"], self._place, REMEDY)
            if text(value["format"]) != FORMAT:
                raise ValueError(f"its format is {value['format']!r}, not {FORMAT!r}")
            if (version := whole_number(value["version"], 1)) > VERSION:
                raise ValueError(
                    f"{self._place} is of version {version}, made by a newer instok3d; this one "
                    f"reads version {VERSION}: update it"
                )
            return Encoder(one_line(value["name"]), whole_number(value["channels"], 1))


def open_milvus(place: str) -> MilvusLibrary:
    """The library of a place such as milvus://localhost:19530/rooms.

    Raises:
        ValueError: The place is none, or the library is damaged or of a newer version.
        ConnectionError: The server does not answer.
        ModuleNotFoundError: pymilvus is not installed.
    """
    parts = urlsplit(place)
    name = parts.path.strip("/")
    if not parts.hostname or not name.isidentifier() or not name.isascii():
        raise ValueError(
            f"{place!r} is no place of a library: wanted is milvus://HOST:PORT/NAME, the name of "
            "letters, digits and _"
        )
    try:
        from pymilvus import MilvusClient
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"{place} needs the package pymilvus; install it with: pip install 'instok3d[search]'"
        ) from error
    with naming_server(place):
        uri = f"http://{parts.hostname}:{parts.port or 19530}"
        client = MilvusClient(uri, token=os.environ.get(TOKEN, ""), timeout=30)
    return MilvusLibrary(client, name, place)


@contextmanager
def naming_server(place: str) -> Iterator[None]:
    """Errors of the server as one sentence.

    Raises:
        ConnectionError: It does not answer.
        ValueError: It refuses.
    """
    from pymilvus.exceptions import ConnectError, MilvusException, MilvusUnavailableException

    try:
        yield
    except MilvusException as error:
        words = " ".join(str(error.message or error).split())[:300]
        if isinstance(error, MilvusUnavailableException | ConnectError) or error.code == 2:
            raise ConnectionError(
                f"the server of {place} does not answer ({words}): is it running?"
            ) from error
        raise ValueError(f"the server of {place} refuses: {words}") from error


def scene_id(scene: str) -> str:
    """A short id of a scene's place."""
    return hashlib.sha256(scene.encode(errors="surrogateescape")).hexdigest()[:32]


def _info(item: Entry) -> str:
    return json.dumps({"key": item.key, "label": item.label, "box": item.box.tolist()})


def _match(row: dict[str, Any], score: float, place: str) -> Match:
    with naming_damage(place, REMEDY):
        info = parse_json(row["info"], place, REMEDY)
        label = info["label"]
        entry = Entry(
            id=whole_number(row["object"]),
            key=one_line(info["key"]),
            label=None if label is None else one_line(label),
            box=np.array(info["box"], np.float32).reshape(2, 3),
            thumbnail=base64.b64decode(row["thumbnail"], validate=True),
        )
        return Match(row["scene"], entry, score)
