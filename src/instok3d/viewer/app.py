"""A scene in the browser: the session, the picture and the panel on one guarded server."""

import html
import tempfile
import threading
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from jaxtyping import UInt8

from instok3d.formats.parts import only_objects
from instok3d.formats.registry import ExportOptions, export_scene
from instok3d.geometry.moving import Similarity
from instok3d.pictures import color_picture
from instok3d.scene.scene import Scene
from instok3d.semantics.query.shipped import shipped_encoder
from instok3d.viewer.cameras import Stand, first_stand, stand_of_view, typical_distance
from instok3d.viewer.folder import SceneFolder
from instok3d.viewer.panel import Panel
from instok3d.viewer.picking import pick
from instok3d.viewer.picture import Picture
from instok3d.viewer.serving import serve, stop_serving
from instok3d.viewer.session import Session
from instok3d.viewer.uploads import LIMIT_MB, MEGABYTE

EXPECTED = (KeyError, ValueError, OSError, ModuleNotFoundError, MemoryError)
"""What a person at the viewer can get wrong, and what this machine may lack."""

TOLD_S = 10.0
"""How long a message stays."""


class Viewer:
    """A running viewer; ends with `stop` or with the program."""

    def __init__(
        self,
        session: Session,
        *,
        host: str,
        port: int,
        token: str | None,
        title: str,
        upload_limit_bytes: int,
    ) -> None:
        """Start it; see `view`."""
        self._session = session
        self._lock = threading.RLock()
        self._stopped = False
        self._server, self._guard = serve(
            host, port, token, title=title, hover=self._name_at,
            upload_limit_bytes=upload_limit_bytes,
        )  # fmt: skip
        self._set_first_camera()
        self._picture = Picture(
            self._server, session.shown, stand_at=self._stand_all_at, moved=self._moved
        )
        self._panel = Panel(
            self._server, session, do=self._do, stand_at=self._stand_at, compare=self._compare,
            show_photos=self._picture.show_photos, use_gizmo=self._use_gizmo, export=self._export,
            upload_limit_bytes=upload_limit_bytes,
        )  # fmt: skip
        self._server.scene.on_click()(lambda event: self._clicked(event, add=False))
        self._server.scene.on_click(modifier="cmd/ctrl")(
            lambda event: self._clicked(event, add=True)
        )
        self._server.on_client_connect(self._connected)

    @property
    def url(self) -> str:
        """The address, with the token: whoever has it can look and edit."""
        return self._guard.url

    @property
    def scene(self) -> Scene:
        """The scene with the edits that were done."""
        return self._session.scene

    def stop(self) -> None:
        """End it, after the edit that is being done; the address does no longer answer."""
        with self._lock:
            self._stopped = True
        stop_serving(self._server)

    def _repr_html_(self) -> str:
        """What a notebook shows: the address."""
        address = html.escape(self.url)
        return f'<a href="{address}" target="_blank" rel="noreferrer">Open the viewer</a>'

    def _do(self, operation: Callable[[], object], client: Any) -> None:
        """Change something, show it, and tell the client of warnings and of what cannot be done."""
        with self._lock:
            if self._stopped:
                return
            with warnings.catch_warnings(record=True) as notes:
                warnings.simplefilter("always")
                try:
                    operation()
                except EXPECTED as error:
                    words = error.args[0] if isinstance(error, KeyError) else error
                    self._tell(client, "Not done", str(words), "red")
            for note in notes:
                self._tell(client, "Note", str(note.message), "yellow")
            self._picture.show(self._session.shown)
            self._panel.show()

    def _tell(self, client: Any, title: str, words: str, color: Literal["red", "yellow"]) -> None:
        """A message at the client who did it, or at all."""
        for each in [client] if client is not None else self._server.get_clients().values():
            each.add_notification(title, words, color=color, auto_close_seconds=TOLD_S)

    def _moved(self, number: int, motion: Similarity) -> None:
        self._do(lambda: self._session.move(number, motion), None)

    def _use_gizmo(self, on: bool) -> None:
        self._picture.with_gizmo = on

    def _clicked(self, event: Any, *, add: bool) -> None:
        stand, height, width = _stand_of(event.client.camera)
        x, y = event.screen_pos
        self._do(
            lambda: self._session.click(
                stand.cam_from_world(), stand.intrinsics(height, width), height, width,
                (float(x) * width, float(y) * height), add=add,
            ),
            event.client,
        )  # fmt: skip

    def _name_at(self, x: float, y: float) -> str:
        """The key of the object that a browser shows there; empty where several browsers look."""
        clients = tuple(self._server.get_clients().values())
        if len(clients) != 1:
            return ""
        (stand, height, width), scene = _stand_of(clients[0].camera), self._session.scene
        found = pick(
            scene, stand.cam_from_world(), stand.intrinsics(height, width), height, width,
            (x * width, y * height),
        )  # fmt: skip
        return scene.object(found.object).key if found.object else ""

    def _set_first_camera(self) -> None:
        scene, camera = self._session.scene, self._server.initial_camera
        stand = first_stand(scene)
        camera.position, camera.up = stand.center, stand.up()
        camera.look_at = stand.look_at(typical_distance(scene))
        camera.fov = stand.vertical_fov_rad
        camera.near, camera.far = scene.near_far

    def _connected(self, client: Any) -> None:
        client.camera.near, client.camera.far = self._session.scene.near_far

    def _stand_at(self, view: int, client: Any) -> None:
        scene = self._session.scene
        stand = stand_of_view(scene, view)
        with client.atomic():
            client.camera.up_direction = stand.up()
            client.camera.position = stand.center
            client.camera.look_at = stand.look_at(typical_distance(scene))
            client.camera.fov = stand.vertical_fov_rad
        with self._lock:
            self._picture.show(self._session.shown, eye=stand.center)

    def _stand_all_at(self, view: int) -> None:
        for client in self._server.get_clients().values():
            self._stand_at(view, client)

    def _compare(self, view: int) -> UInt8[np.ndarray, "height width 3"]:
        scene = self._session.scene
        rendered = color_picture(scene.render([view]).colors[0])
        return np.concatenate([scene.photos[view].cpu().numpy(), rendered], axis=1)

    def _export(self, ending: str, alone: bool, client: Any) -> None:
        def send() -> None:
            scene = self._session.scene
            chosen = [item.id for item in self._session.selected]
            if alone and not chosen:
                raise ValueError("select an object first: click in the picture, or in the list")
            part = only_objects(scene, chosen) if alone else scene.drawn()
            with tempfile.TemporaryDirectory() as folder:
                export_scene(part, Path(folder) / f"scene{ending}", ExportOptions())
                for file in sorted(Path(folder).iterdir()):
                    client.send_file_download(file.name, file.read_bytes())

        self._do(send, client)


def _stand_of(camera: Any) -> tuple[Stand, int, int]:
    """Where a browser's camera stands, and the height and width of its picture."""
    height, width = camera.image_height, camera.image_width
    (x, y, z), (w, i, j, k) = camera.position.tolist(), camera.wxyz.tolist()
    return Stand((x, y, z), (w, i, j, k), float(camera.fov), width / height), height, width


def view(
    scene: Scene,
    *,
    folder: SceneFolder | None = None,
    others: Mapping[str, Scene] = MappingProxyType({}),
    host: str = "127.0.0.1",
    port: int = 8080,
    token: str | None = None,
    title: str = "InsTok3D",
    upload_limit_bytes: int = LIMIT_MB * MEGABYTE,
) -> Viewer:
    """Show a scene in the browser; returns at once.

    Args:
        scene: What is shown and edited.
        folder: Keeps the edits; None keeps them in memory, see `Viewer.scene`.
        others: Scenes whose objects can be inserted, by name.
        host: Address to listen on; others than this machine's own let the network in.
        port: The first free one from this on is taken; 0 takes any.
        token: Of the address; None makes a random one.
        title: At the head of the panel.
        upload_limit_bytes: Of a file that a browser may send to insert objects from; 0: none.

    Raises:
        ModuleNotFoundError: viser is not installed.
        ValueError: A bad token, no such address or port, or a limit below 0.
    """
    if upload_limit_bytes < 0:
        raise ValueError(
            f"the upload limit must be 0 (no uploads) or more, got {upload_limit_bytes}"
        )
    encoder = shipped_encoder(scene.semantics) if scene.semantics else None
    session = Session(scene, folder=folder, others=others, encoder=encoder)
    return Viewer(
        session, host=host, port=port, token=token, title=title,
        upload_limit_bytes=upload_limit_bytes,
    )  # fmt: skip
