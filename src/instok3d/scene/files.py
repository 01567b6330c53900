"""The scene folder (`room.itk`): JSON, safetensors and PNG, nothing that runs code when read.

scene.json (`header`): version, units, frame, model, seed, hashes of the photos, warnings.
cameras.json (`camera_list`): a list, one entry a view. objects.json (`object_list`): the objects by
a published schema. gaussians.safetensors and tokens.safetensors (`tensor_files`): the fields of
`Gaussians` and `SceneTokens`, float32 (anchor_index int64). inputs/NNN.png, read here: the photos
as the model saw them. semantics/ENCODER.safetensors (`semantic_files`), where there are any:
`SceneSemantics` as float16. docs/formats.md has every field; what else lies in the folder, such as
previews/, is not read.
"""

import hashlib
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image
from torch import Tensor

from instok3d.files import (
    json_text,
    replacing,
    replacing_folder,
    safetensors_bytes,
    sha256_of,
    write_safetensors,
)
from instok3d.locking import bring_back
from instok3d.pictures import save_png
from instok3d.reading import naming_damage, open_png, text, whole_number
from instok3d.scene.camera_list import cameras_document, read_cameras
from instok3d.scene.header import REMEDY, read_about, read_header, scene_document
from instok3d.scene.object_list import objects_document, read_objects
from instok3d.scene.record import SceneRecord, near_and_far
from instok3d.scene.semantic_files import read_semantics, write_semantics
from instok3d.scene.sight import looked_at_later
from instok3d.scene.tensor_files import TENSOR_FILES, read_gaussians, read_tokens
from instok3d.scene.versions import FROM_GAUSSIANS, VERSION
from instok3d.scene.vertical import find_vertical
from instok3d.types import Gaussians, check_gaussians


def save_record(
    scene: SceneRecord,
    path: Path,
    *,
    overwrite: bool = False,
    more: Callable[[Path], None] | None = None,
    edited: int = 0,
) -> None:
    """Write the scene folder, complete or not at all; the same scene gives the same bytes.

    Args:
        scene: What to write.
        path: The folder, such as room.itk.
        overwrite: Replace a scene that is already there; it stays until the new one is complete.
        more: Called with the folder before it gets its name, to write more files into it.
        edited: How many edits the log has that `more` writes.

    Raises:
        FileExistsError: Something is at `path`, and `overwrite` is off or it is no scene.
        FileNotFoundError: The folder that `path` is to stand in is not there.
        PermissionError: That folder may not be written to.
        ValueError: The scene has Gaussians that cannot be drawn.
    """
    check_target(path, overwrite=overwrite)
    check_gaussians(scene.gaussians, "the scene")
    with replacing_folder(path, overwrite=overwrite) as part:
        if more is not None:
            more(part)
        (part / "inputs").mkdir()
        for index, photo in enumerate(scene.photos):
            save_png(Image.fromarray(photo.cpu().numpy()), _photo_path(part / "inputs", index))
        for name in TENSOR_FILES:
            stage = scene.gaussians if name.startswith("gaussians") else scene.tokens
            write_safetensors(part / name, vars(stage))
        _write_json(part / "cameras.json", cameras_document(scene))
        _write_json(part / "objects.json", objects_document(scene))
        digests = {name: sha256_of(part / name) for name in sorted(TENSOR_FILES)}
        header = scene_document(scene, digests) | {"edited": edited}
        if scene.semantics:
            header["semantics"] = write_semantics(part, scene.semantics)
        _write_json(part / "scene.json", header)


def gaussians_sha256(gaussians: Gaussians) -> str:
    """SHA-256 of the gaussians.safetensors that a scene of these Gaussians has."""
    return hashlib.sha256(safetensors_bytes(vars(gaussians))).hexdigest()


def check_target(path: Path, *, overwrite: bool) -> None:
    """Fail before any work is done if a scene could not be saved at `path`.

    Raises:
        FileExistsError: Something is at `path`, and `overwrite` is off or it is no scene.
        FileNotFoundError: The folder that `path` is to stand in is not there.
        PermissionError: That folder may not be written to.
    """
    if not path.resolve().parent.is_dir():
        raise FileNotFoundError(f"cannot write {path}: there is no folder {path.resolve().parent}")
    if not os.access(path.resolve().parent, os.W_OK):
        raise PermissionError(f"cannot write {path}: {path.resolve().parent} may not be written to")
    bring_back(path)
    if not os.path.lexists(path):
        return
    if not overwrite:
        raise FileExistsError(f"{path} is already there; pass --overwrite to replace it")
    if path.is_symlink() or not (path / "scene.json").is_file():
        raise FileExistsError(
            f"{path} is not a scene folder and will not be replaced; choose another name"
        )


def load_record(path: Path, *, hub: str = "") -> SceneRecord:
    """What the folder of a scene holds, on the CPU, before any edit of its log.

    Older versions are upgraded in memory.

    Args:
        path: The folder.
        hub: The name at a commit of the hub that the folder was fetched from, if it was.

    Raises:
        FileNotFoundError: No folder there, or a file of it is missing.
        ValueError: It is of a newer version, damaged, or inconsistent; the sentence names the
            file and what is wrong with it.
    """
    header, file = read_header(path), path / "scene.json"
    with naming_damage(file, REMEDY):
        about = read_about(header)
        digests = {name: text(header["sha256"][name]) for name in TENSOR_FILES}
        encoders = {name: text(value) for name, value in dict(header.get("semantics", {})).items()}
    height, width = about["height"], about["width"]
    gaussians = read_gaussians(path, digests)
    tokens = read_tokens(path, digests)
    cameras, views = read_cameras(path / "cameras.json", about["frame"], height, width)
    objects = read_objects(
        path / "objects.json", REMEDY, num_views=len(views), height=height, width=width,
        num_gaussians=len(gaussians.means), num_groups=len(tokens.groups),
    )  # fmt: skip
    num_anchors = len(tokens.assignment)
    if len(gaussians.anchor_index) and int(gaussians.anchor_index.max()) >= num_anchors:
        raise ValueError(f"{path / 'gaussians.safetensors'}: anchor_index beyond {num_anchors}")
    if hub:
        about["provenance"] = replace(about["provenance"], hub=hub)
    if about["near_far"] == FROM_GAUSSIANS:
        about["near_far"] = near_and_far(gaussians, cameras)
    if about["vertical"] is None:
        about["vertical"] = find_vertical(cameras.cam_from_world, about["frame"])
    record = SceneRecord(
        **about,
        gaussians=gaussians,
        tokens=tokens,
        cameras=cameras,
        views=views,
        objects=objects,
        photos=_read_photos(path / header["inputs_folder"], len(views), height, width),
        semantics=read_semantics(
            path, encoders, REMEDY, groups=len(tokens.groups), anchors=num_anchors
        ),
    )
    whole = all(len(item.sight.masks) == len(item.visible_in) for item in objects)
    return record if whole else looked_at_later(record)  # versions 1 to 3 kept no masks


def read_digest(path: Path) -> tuple[str, int]:
    """The SHA-256 of a scene's gaussians.safetensors, and the number of edits that it says to have.

    Raises:
        FileNotFoundError, ValueError: As `load_record`.
    """
    header = read_header(path)
    with naming_damage(path / "scene.json", REMEDY):
        digest = text(header["sha256"]["gaussians.safetensors"])
        return digest, whole_number(header.get("edited", 0))


def write_edited(path: Path, record: SceneRecord, edited: int) -> None:
    """Say in the scene.json of a folder, whose other files stay, how many edits its log has.

    Args:
        path: The scene folder.
        record: What `load_record` gives of it.
        edited: Edits that are done.
    """
    header = read_header(path)
    header |= {"version": VERSION, "near_far": list(record.near_far), "edited": edited}
    write_text = json_text(header) + "\n"
    with replacing(path / "scene.json") as part:
        part.write_text(write_text, encoding="utf-8")


def _read_photos(
    folder: Path, count: int, height: int, width: int
) -> UInt8[Tensor, "view {height} {width} 3"]:
    """The photos; memory for all of them is taken when all are known to be of that size."""
    files = [_photo_path(folder, index) for index in range(count)]
    for file in files:
        if not file.is_file():
            raise FileNotFoundError(f"the scene is incomplete: {file} is missing")
        with naming_damage(file, REMEDY), open_png(file) as picture:
            if picture.size != (width, height):
                raise ValueError(f"{file}: size {picture.size}, wanted {(width, height)}")
    photos = torch.empty(count, height, width, 3, dtype=torch.uint8)
    for index, file in enumerate(files):
        with naming_damage(file, REMEDY), open_png(file) as picture:
            photos[index] = torch.from_numpy(np.array(picture.convert("RGB")))
    return photos


def _photo_path(folder: Path, index: int) -> Path:
    return folder / f"{index:03d}.png"


def _write_json(file: Path, value: Any) -> None:
    file.write_text(json_text(value) + "\n", encoding="utf-8")
