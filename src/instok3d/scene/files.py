"""The scene folder (`room.itk`): JSON, safetensors and PNG, nothing that runs code when read.

scene.json: version, units, frame, model, seed, hashes of the photos, warnings. cameras.json: a
list, one entry a view. objects.json: the objects by a published schema. gaussians.safetensors and
tokens.safetensors: the fields of `Gaussians` and `SceneTokens`, float32 (anchor_index int64).
inputs/NNN.png: the photos as the model saw them. semantics/ENCODER.safetensors, where there are
any: `SceneSemantics` as float16. docs/formats.md has every field; what else lies
in the folder, such as previews/, is not read.
"""

import dataclasses
import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image
from safetensors.torch import load_file
from torch import Tensor

from instok3d.files import (
    json_text,
    replacing,
    replacing_folder,
    safetensors_bytes,
    sha256_of,
    write_safetensors,
)
from instok3d.geometry.camera_json import read_intrinsics, read_pose
from instok3d.geometry.cameras import invert_rigid
from instok3d.locking import bring_back
from instok3d.photos.pixel_map import PixelMap
from instok3d.pictures import save_png
from instok3d.reading import naming_damage, number, one_of, open_png, read_json, text, whole_number
from instok3d.scene.object_list import objects_document, read_entries, read_objects
from instok3d.scene.picture_size import MAX_PICTURE_PIXELS
from instok3d.scene.record import (
    MAX_FAR,
    CleanUpRecord,
    Provenance,
    RefinementRecord,
    SceneRecord,
    SceneTokens,
    SceneView,
    near_and_far,
)
from instok3d.scene.semantic_files import read_semantics, write_semantics
from instok3d.scene.sight import looked_at_later
from instok3d.scene.versions import FROM_GAUSSIANS, VERSION, upgraded
from instok3d.scene.vertical import Vertical, find_vertical
from instok3d.types import Cameras, Gaussians, check_gaussians

AXES = {
    "first camera": "OpenCV: x right, y down, z forward; quaternions wxyz; pixel centres at +0.5",
    "given cameras": "cameras OpenCV: x right, y down, z forward; the world as they were given in; "
    "quaternions wxyz; pixel centres at +0.5",
    "file": "the world of the imported file; quaternions wxyz",
}
"""By frame."""
TENSOR_FILES = {"gaussians.safetensors": Gaussians, "tokens.safetensors": SceneTokens}
FORMAT = "instok3d scene"
REMEDY = "reconstruct the scene again"
MAX_VIEWS = 10_000
"""More are taken for damage before anything is allocated, as are views that are too large."""


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
        _write_json(part / "cameras.json", _cameras_json(scene))
        _write_json(part / "objects.json", objects_document(scene))
        digests = {name: sha256_of(part / name) for name in sorted(TENSOR_FILES)}
        header = _scene_json(scene, digests) | {"edited": edited}
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


def load_record(path: Path) -> SceneRecord:
    """What the folder of a scene holds, on the CPU, before any edit of its log.

    Older versions are upgraded in memory.

    Raises:
        FileNotFoundError: No folder there, or a file of it is missing.
        ValueError: It is of a newer version, damaged, or inconsistent; the sentence names the
            file and what is wrong with it.
    """
    header, file = _read_header(path), path / "scene.json"
    with naming_damage(file, REMEDY):
        about = _about(header)
        digests = {name: text(header["sha256"][name]) for name in TENSOR_FILES}
        encoders = {name: text(value) for name, value in dict(header.get("semantics", {})).items()}
    height, width = about["height"], about["width"]
    gaussians = _read_gaussians(path, digests)
    tokens = _read_tokens(path, digests)
    cameras, views = _read_cameras(path / "cameras.json", about["frame"], height, width)
    objects = read_objects(
        path / "objects.json", REMEDY, num_views=len(views), height=height, width=width,
        num_gaussians=len(gaussians.means), num_groups=len(tokens.groups),
    )  # fmt: skip
    num_anchors = len(tokens.assignment)
    if len(gaussians.anchor_index) and int(gaussians.anchor_index.max()) >= num_anchors:
        raise ValueError(f"{path / 'gaussians.safetensors'}: anchor_index beyond {num_anchors}")
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
    header = _read_header(path)
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
    header = _read_header(path)
    header |= {"version": VERSION, "near_far": list(record.near_far), "edited": edited}
    write_text = json_text(header) + "\n"
    with replacing(path / "scene.json") as part:
        part.write_text(write_text, encoding="utf-8")


def _read_header(path: Path) -> dict[str, Any]:
    """scene.json as one of today."""
    bring_back(path)
    if not path.is_dir():
        raise FileNotFoundError(f"{path} is not a scene folder: no folder of this name is there")
    file = path / "scene.json"
    if not file.is_file():
        raise FileNotFoundError(f"{path} is not a scene folder: it has no scene.json")
    return upgraded(read_json(file, REMEDY), file)


def _about(header: dict[str, Any]) -> dict[str, Any]:
    """The fields of the scene that scene.json says itself."""
    height, width = whole_number(header["height"], 1), whole_number(header["width"], 1)
    if height * width > MAX_PICTURE_PIXELS:
        raise ValueError(f"bad picture size {height} x {width}")
    one_of(header["format"], (FORMAT,))
    near_far, made = header["near_far"], header["provenance"]
    return {
        "height": height,
        "width": width,
        "units": one_of(header["units"], ("metres", "arbitrary")),
        "frame": one_of(header["frame"], tuple(AXES)),
        "vertical": Vertical.from_json(header["vertical"]) if "vertical" in header else None,
        "near_far": near_far if near_far == FROM_GAUSSIANS else _near_far(near_far),
        "warnings": tuple(text(line) for line in header["warnings"]),
        "provenance": Provenance(
            generator=text(made["generator"]),
            model=text(made["model"]),
            model_sha256=text(made["model_sha256"]),
            seed=whole_number(made["seed"]),
            geometry=text(made.get("geometry", "")),
            geometry_sha256=text(made.get("geometry_sha256", "")),
            refinements=tuple(_refinement(each) for each in made.get("refinements", ())),
            clean_up=_clean_up(made.get("clean_up")),
            edits=tuple(text(each) for each in made.get("edits", ())),
            invented=whole_number(made.get("invented", 0)),
            edited_from=text(made.get("edited_from", "")),
        ),
    }


def _clean_up(value: dict[str, Any] | None) -> CleanUpRecord | None:
    if value is None:
        return None
    return CleanUpRecord(whole_number(value["joined"]), whole_number(value["moved"]))


def _refinement(value: dict[str, Any]) -> RefinementRecord:
    return RefinementRecord(
        steps=whole_number(value["steps"]),
        height=whole_number(value["height"], 1),
        width=whole_number(value["width"], 1),
        split_share=number(value["split_share"]),
        seed=whole_number(value["seed"]),
        psnr_before=number(value["psnr_before"]),
        psnr_after=number(value["psnr_after"]),
    )


def _scene_json(scene: SceneRecord, digests: dict[str, str]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "units": scene.units,
        "frame": scene.frame,
        "axes": AXES[scene.frame],
        "vertical": dataclasses.asdict(scene.vertical),
        "near_far": list(scene.near_far),
        "inputs_folder": "inputs",
        "height": scene.height,
        "width": scene.width,
        "num_views": len(scene.views),
        "num_objects": len(scene.objects),
        "num_anchors": scene.tokens.assignment.shape[0],
        "num_gaussians": len(scene.gaussians.means),
        "provenance": dataclasses.asdict(scene.provenance),
        "tokens_give_gaussians": scene.provenance.tokens_give_gaussians,
        "inputs": {view.file: view.sha256 for view in scene.views},
        "warnings": list(scene.warnings),
        "sha256": digests,
    }


def _cameras_json(scene: SceneRecord) -> list[dict[str, Any]]:
    cam_from_world = scene.cameras.cam_from_world.detach().cpu()
    world_from_cam = invert_rigid(cam_from_world)
    return [
        {
            "file": view.file,
            "sha256": view.sha256,
            "height": scene.height,
            "width": scene.width,
            "intrinsics": scene.cameras.intrinsics[index].tolist(),
            "cam_from_world": cam_from_world[index].tolist(),
            "world_from_cam": world_from_cam[index].tolist(),
            "photo_intrinsics": view.pixel_map.intrinsics_to_original(
                scene.cameras.intrinsics[index].double().cpu()
            ).tolist(),
            "pixel_map": dataclasses.asdict(view.pixel_map),
        }
        for index, view in enumerate(scene.views)
    ]


def _read_gaussians(path: Path, digests: dict[str, str]) -> Gaussians:
    file = path / "gaussians.safetensors"
    tensors = _read_tensors(file, digests, Gaussians)
    count = len(tensors["means"])
    coefficients = tensors["sh"].shape[1] if tensors["sh"].ndim == 3 else 0
    shapes = {
        "means": (count, 3), "quats": (count, 4), "scales": (count, 3), "opacities": (count,),
        "sh": (count, coefficients, 3), "anchor_index": (count,),
    }  # fmt: skip
    _check_shapes(file, tensors, shapes)
    gaussians = Gaussians(**tensors)
    check_gaussians(gaussians, file)
    return gaussians


def _read_tokens(path: Path, digests: dict[str, str]) -> SceneTokens:
    file = path / "tokens.safetensors"
    tensors = _read_tensors(file, digests, SceneTokens)
    num_anchors, num_groups = len(tensors["positions"]), len(tensors["groups"])
    channels = tensors["anchors"].shape[-1]
    shapes = {
        "positions": (num_anchors, 3),
        "anchors": (num_anchors, channels),
        "groups": (num_groups, channels),
        "assignment": (num_anchors, num_groups + 1),
    }
    _check_shapes(file, tensors, shapes)
    for name, value in tensors.items():
        if not value.isfinite().all():
            raise ValueError(f"{file}: {name} holds numbers that are not finite")
    assignment = tensors["assignment"]
    if (assignment < 0).any() or ((assignment.sum(dim=1) - 1).abs() > 1e-2).any():
        raise ValueError(f"{file}: assignment holds rows that are no probabilities")
    return SceneTokens(**tensors)


def _read_tensors(file: Path, digests: dict[str, str], kind: type) -> dict[str, Tensor]:
    """The tensors of one file: all that `kind` has, of the right type, whole."""
    if not file.is_file():
        raise FileNotFoundError(f"the scene is incomplete: {file} is missing")
    if sha256_of(file) != digests[file.name]:
        raise ValueError(f"{file} is damaged: it is not the file that scene.json was written for")
    with naming_damage(file, REMEDY):
        tensors = load_file(file)
    names = {field.name for field in dataclasses.fields(kind)}
    if tensors.keys() != names:
        raise ValueError(f"{file}: wanted the tensors {sorted(names)}, found {sorted(tensors)}")
    for name, value in tensors.items():
        wanted = torch.int64 if name == "anchor_index" else torch.float32
        if value.dtype != wanted or value.ndim == 0:
            raise ValueError(f"{file}: {name} is {value.dtype} {tuple(value.shape)}, not {wanted}")
    return tensors


def _check_shapes(file: Path, tensors: dict[str, Tensor], shapes: dict[str, tuple]) -> None:
    for name, shape in shapes.items():
        if tuple(tensors[name].shape) != tuple(shape):
            raise ValueError(f"{file}: {name} is {tuple(tensors[name].shape)}, wanted {shape}")


def _read_cameras(
    file: Path, frame: str, height: int, width: int
) -> tuple[Cameras, tuple[SceneView, ...]]:
    """The views; only an imported scene may have none."""
    entries = read_entries(file, REMEDY)
    least = 0 if frame == "file" else 1
    if not least <= len(entries) <= MAX_VIEWS:
        raise ValueError(f"{file}: wanted a list of {least} to {MAX_VIEWS} views")
    poses, intrinsics = [torch.zeros(0, 4, 4)], [torch.zeros(0, 3, 3)]
    views = []
    for index, entry in enumerate(entries):
        where = f"{file}: view {index}"
        with naming_damage(where, REMEDY):
            if (entry["height"], entry["width"]) != (height, width):
                raise ValueError(f"its size is not that of scene.json, {height} x {width}")
            pixel_map = _pixel_map(entry["pixel_map"], height, width)
            views.append(SceneView(text(entry["file"]), text(entry["sha256"]), pixel_map))
            poses.append(read_pose(entry["cam_from_world"], where=where).float()[None])
            intrinsics.append(
                read_intrinsics(
                    entry["intrinsics"], where=where, height=height, width=width
                ).float()[None]
            )
    return Cameras(torch.cat(poses), torch.cat(intrinsics)), tuple(views)


def _pixel_map(value: dict[str, Any], height: int, width: int) -> PixelMap:
    pixel_map = PixelMap(
        original_height=whole_number(value["original_height"], 1),
        original_width=whole_number(value["original_width"], 1),
        exif_orientation=whole_number(value["exif_orientation"], 1, 8),
        height=whole_number(value["height"], 1),
        width=whole_number(value["width"], 1),
        scale_x=number(value["scale_x"]),
        scale_y=number(value["scale_y"]),
        offset_x=number(value["offset_x"]),
        offset_y=number(value["offset_y"]),
    )
    if (pixel_map.height, pixel_map.width) != (height, width):
        raise ValueError(f"its pixel_map is not to pictures of {height} x {width}")
    if min(pixel_map.scale_x, pixel_map.scale_y) <= 0:
        raise ValueError("its pixel_map has a scale that is not above 0")
    return pixel_map


def _near_far(value: Any) -> tuple[float, float]:
    near, far = map(number, value)
    if not 0 < near < far <= MAX_FAR:
        raise ValueError(f"near_far is {near:g}, {far:g}; wanted 0 < near < far <= {MAX_FAR:g}")
    return near, far


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
