"""Files that a browser sends, to insert objects from: their size, their names, what is in them.

Whoever has the token can send any bytes. So no more than a limit is taken, no path or name on this
machine comes from the browser, and the bytes go through the readers for files that nobody trusts.
"""

import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import torch

from instok3d.formats.importing import import_scene
from instok3d.formats.registry import format_of, readable
from instok3d.reading import naming_damage, open_png, open_zip
from instok3d.scene.from_gaussians import scene_from_gaussians
from instok3d.scene.scene import Scene
from instok3d.scene.versions import INPUTS_FOLDERS

MEGABYTE = 2**20
LIMIT_MB = 256
"""Of one file: a million Gaussians of degree 3 as .ply."""
LONGEST = 60
"""Characters of a name that is shown."""
MAX_PARTS = 4096
"""Files in a zipped scene folder."""
REMEDY = "send a whole one"
PLAIN = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
SCENE = ".zip"


class UploadGate:
    """Stands before viser's own handlers, which keep all that they are sent."""

    def __init__(self, gui: Any, limit_bytes: int) -> None:
        """Let nothing through that is larger than the limit; 0 lets nothing through."""
        self._gui, self._limit_bytes = gui, limit_bytes

    def start(self, client: int, message: Any) -> None:
        """A file is said to come: refused by its size, or because others are still coming.

        What is refused is answered as if all of it had come, so that the page waits no longer.
        """
        others = sum(each["total_bytes"] for each in self._coming().values())
        size, parts = message.size_bytes, message.part_count
        known = message.transfer_uuid in self._coming()
        if 0 < parts <= size <= self._limit_bytes - others and not known:
            self._gui._handle_file_transfer_start(client, message)
            return
        self._settle(message.source_component_uuid, message.transfer_uuid, size)
        button = self._gui._gui_input_handle_from_uuid.get(message.source_component_uuid)
        shown, found = self._gui._resolve_client(client), f"{shown_name(message.filename)}: "
        if shown is None or button is None:
            return
        if size > self._limit_bytes:
            found += (
                f"{size:,} bytes are more than the {self._limit_bytes:,} that this viewer takes; "
                "start it with a larger --upload-limit, or name the scene behind the first one"
            )
        else:
            found += "it is empty, or another file is still coming; send one after the other"
        shown.add_notification("Not done", found, color="red", auto_close_seconds=10)

    def part(self, client: int, message: Any) -> None:
        """A piece of a file: dropped with the file where it is not what was said to come."""
        state = self._coming().get(message.transfer_uuid)
        if state is None or state["client_id"] != client:
            return
        length = len(message.content)
        if not length or state["transferred_bytes"] + length > state["total_bytes"]:
            del self._coming()[message.transfer_uuid]
            self._settle(message.source_component_uuid, message.transfer_uuid, state["total_bytes"])
            return
        self._gui._handle_file_transfer_part(client, message)

    def _coming(self) -> dict[str, Any]:
        return self._gui._current_file_upload_states

    def _settle(self, button: str | None, transfer: str, size: int) -> None:
        from viser import _messages

        self._gui._websock_interface.queue_message(
            _messages.FileTransferPartAck(
                source_component_uuid=button, transfer_uuid=transfer,
                transferred_bytes=size, total_bytes=size,
            )
        )  # fmt: skip


def taken_from(button: Any) -> Any:
    """The file that came by a button, which keeps it no longer."""
    file = button.value
    button._impl.value = type(file)("", b"")
    return file


def shown_name(given: str) -> str:
    """The last part of a name from a browser, to be shown: printable and short."""
    last = given.replace("\\", "/").rpartition("/")[2]
    plain = "".join(sign if sign.isprintable() else "?" for sign in last).strip()
    return plain[-LONGEST:] or "file"


def accepted() -> str:
    """Endings of the files that can be sent, for the browser's choice of files."""
    return ",".join((*readable(), SCENE))


def uploaded_scene(given: str, content: bytes, limit_bytes: int) -> Scene:
    """The scene of a file that a browser sent.

    A file of Gaussians of any format that is read; where it names no objects, all of it is one.
    Or a zipped scene folder. It lies in a folder of its own, under a name of ours, while it is
    read.

    Args:
        given: Its name, of which the ending alone counts.
        content: All of it.
        limit_bytes: That the content of a zipped scene may have when it is unpacked, and its
            photos when they are decoded.

    Raises:
        ModuleNotFoundError: The format needs a package that is not installed.
        ValueError: It is damaged, or of no kind that is read.
    """
    name = shown_name(given)
    with tempfile.TemporaryDirectory() as folder:
        is_scene = name.lower().endswith(SCENE)
        suffix = SCENE if is_scene else format_of(Path(name), to_write=False).suffix
        path = Path(folder) / f"upload{suffix}"
        path.write_bytes(content)
        try:
            if is_scene:
                scene = Scene.load(_unpacked(path, limit_bytes))
            else:
                scene = _with_an_object(import_scene(path), name)
        except (OSError, KeyError, ValueError) as error:
            words = str(error.args[0] if isinstance(error, KeyError) else error)
            shown = words.replace(str(path), name).replace(f"{folder}/", f"{name}: ")
            raise ValueError(shown) from error
    return scene


def _with_an_object(scene: Scene, name: str) -> Scene:
    """The scene under its own name; where no object of it is known, all of it is one."""
    made = replace(scene.provenance, model=f"imported from {name}")
    scene = replace(scene, provenance=made)
    if scene.objects:
        return scene
    everything = torch.ones(len(scene.gaussians.means), dtype=torch.long)
    whole = scene_from_gaussians(
        scene.gaussians, everything, provenance=scene.provenance, units=scene.units,
        vertical=scene.vertical, notes=scene.warnings,
    )  # fmt: skip
    return replace(whole, near_far=scene.near_far)


def _unpacked(path: Path, limit_bytes: int) -> Path:
    """The scene folder in a zip file, unpacked beside it: checked names, checked sizes.

    Raises:
        ValueError: It is damaged, too large, holds no scene.json, or something that no scene folder
            has.
    """
    target = path.parent / "scene"
    with naming_damage(path, REMEDY), open_zip(path) as archive:
        entries = [entry for entry in archive.infolist() if not entry.is_dir()]
        if len(entries) > MAX_PARTS:
            raise ValueError(f"it has {len(entries)} files")
        total = sum(entry.file_size for entry in entries)
        if total > limit_bytes:
            raise ValueError(f"unpacked it has {total:,} bytes; at most {limit_bytes:,} are taken")
        if any(entry.compress_type not in PLAIN or entry.flag_bits & 1 for entry in entries):
            raise ValueError("its files are locked, or packed by another method than deflated")
        heads = [each for each in map(_parts_of, entries) if each[-1] == "scene.json"]
        if not heads:
            raise ValueError("there is no scene.json in it")
        above = min(heads, key=len)[:-1]
        for entry in entries:
            parts = _parts_of(entry)
            if parts[: len(above)] == above:
                file = target.joinpath(*parts[len(above) :])
                file.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(entry) as packed:  # no more than the size that it is said to have
                    file.write_bytes(packed.read(entry.file_size))
        pixels = 3 * sum(map(_num_pixels, _photos(target)))
        if pixels > limit_bytes:
            raise ValueError(
                f"its photos have {pixels:,} bytes of pixels; at most {limit_bytes:,} are taken"
            )
    return target


def _photos(scene: Path) -> list[Path]:
    return [file for folder in INPUTS_FOLDERS for file in (scene / folder).glob("*.png")]


def _num_pixels(photo: Path) -> int:
    """What a PNG file says to have: a few kilobytes can be a hundred megabytes of one colour."""
    with naming_damage(photo, REMEDY), open_png(photo) as picture:
        return picture.width * picture.height


def _parts_of(entry: zipfile.ZipInfo) -> tuple[str, ...]:
    """The folders and the name of a file in an archive.

    Raises:
        ValueError: They lead elsewhere, or are no plain names.
    """
    parts = PurePosixPath(entry.filename).parts
    bad = {"..", "/", "."} & set(parts)
    if bad or not parts or any(sign in entry.filename for sign in ("\\", ":", "\0")):
        raise ValueError(f"a file in it is named {entry.filename[:80]!r}")
    return parts
