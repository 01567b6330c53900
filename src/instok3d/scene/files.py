"""The scene folder (`room.itk`): JSON, safetensors and PNG, nothing that runs code when read.

scene.json: version, units, frame, model, seed, hashes of the photos, warnings. cameras.json: a
list, one entry a view. objects.json: a list, one entry an object. gaussians.safetensors and
tokens.safetensors: the fields of `Gaussians` and `SceneTokens`, float32 (anchor_index int64).
inputs/NNN.png: the photos as the model saw them. docs/formats.md has every field; what else lies
in the folder, such as previews/, is not read.
"""

import dataclasses
import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from instok3d.files import json_text, replacing_folder, sha256_of, write_safetensors
from instok3d.geometry.cameras import invert_rigid
from instok3d.locking import bring_back
from instok3d.photos.pixel_map import PixelMap
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import Provenance, SceneRecord, SceneTokens, SceneView, near_and_far
from instok3d.scene.versions import FROM_GAUSSIANS, VERSION, upgraded
from instok3d.types import Cameras, Gaussians

AXES = "OpenCV: x right, y down, z forward; quaternions wxyz; pixel centres at +0.5"
TENSOR_FILES = {"gaussians.safetensors": Gaussians, "tokens.safetensors": SceneTokens}
MAX_VIEWS = 10_000
MAX_PIXELS = 2**26
"""Sizes beyond these are taken for damage before anything is allocated."""


def save_record(
    scene: SceneRecord,
    path: Path,
    *,
    overwrite: bool = False,
    more: Callable[[Path], None] | None = None,
) -> None:
    """Write the scene folder, complete or not at all; the same scene gives the same bytes.

    Args:
        scene: What to write.
        path: The folder, such as room.itk.
        overwrite: Replace a scene that is already there; it stays until the new one is complete.
        more: Called with the folder before it gets its name, to write more files into it.

    Raises:
        FileExistsError: Something is at `path`, and `overwrite` is off or it is no scene.
        FileNotFoundError: The folder that `path` is to stand in is not there.
        PermissionError: That folder may not be written to.
    """
    check_target(path, overwrite=overwrite)
    with replacing_folder(path, overwrite=overwrite) as part:
        if more is not None:
            more(part)
        (part / "inputs").mkdir()
        for index, photo in enumerate(scene.photos):
            Image.fromarray(photo.cpu().numpy()).save(_photo_path(part / "inputs", index))
        for name in TENSOR_FILES:
            stage = scene.gaussians if name.startswith("gaussians") else scene.tokens
            write_safetensors(part / name, vars(stage))
        _write_json(part / "cameras.json", _cameras_json(scene))
        _write_json(part / "objects.json", [item.to_json() for item in scene.objects])
        digests = {name: sha256_of(part / name) for name in sorted(TENSOR_FILES)}
        _write_json(part / "scene.json", _scene_json(scene, digests))


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
    """What the folder of a scene holds, on the CPU; older versions are upgraded in memory.

    Raises:
        FileNotFoundError: No folder there, or a file of it is missing.
        ValueError: It is of a newer version, damaged, or inconsistent; the sentence names the
            file and what is wrong with it.
    """
    bring_back(path)
    if not path.is_dir():
        raise FileNotFoundError(f"{path} is not a scene folder: no folder of this name is there")
    if not (path / "scene.json").is_file():
        raise FileNotFoundError(f"{path} is not a scene folder: it has no scene.json")
    header = upgraded(_read_json(path / "scene.json"), path / "scene.json")
    try:
        return _assemble(path, header)
    except (KeyError, TypeError, IndexError, OverflowError) as error:
        raise ValueError(
            f"{path} is damaged: {type(error).__name__} {error} in its JSON"
        ) from error


def _assemble(path: Path, header: dict[str, Any]) -> SceneRecord:
    height, width = int(header["height"]), int(header["width"])
    if min(height, width) < 1 or height * width > MAX_PIXELS:
        raise ValueError(f"{path / 'scene.json'}: bad picture size {height} x {width}")
    gaussians = _read_gaussians(path, header["sha256"])
    tokens = _read_tokens(path, header["sha256"])
    cameras, views = _read_cameras(path / "cameras.json")
    objects = _read_objects(path / "objects.json", len(views), gaussians, tokens)
    num_anchors = tokens.assignment.shape[0]
    index = gaussians.anchor_index
    if len(index) and (int(index.min()) < 0 or int(index.max()) >= num_anchors):
        raise ValueError(f"{path / 'gaussians.safetensors'}: anchor_index beyond {num_anchors}")
    made = header["provenance"]
    near_far = header["near_far"]
    return SceneRecord(
        gaussians=gaussians,
        tokens=tokens,
        cameras=cameras,
        height=height,
        width=width,
        objects=objects,
        views=views,
        photos=_read_photos(path / header["inputs_folder"], len(views), height, width),
        units=_one_of(path, header["units"], ("metres", "arbitrary")),
        frame=_one_of(path, header["frame"], ("first camera", "given cameras")),
        near_far=(
            near_and_far(gaussians, cameras)
            if near_far == FROM_GAUSSIANS
            else _near_far(path / "scene.json", near_far)
        ),
        warnings=tuple(str(line) for line in header["warnings"]),
        provenance=Provenance(
            generator=str(made["generator"]),
            model=str(made["model"]),
            model_sha256=str(made["model_sha256"]),
            seed=int(made["seed"]),
        ),
    )


def _scene_json(scene: SceneRecord, digests: dict[str, str]) -> dict[str, Any]:
    return {
        "format": "instok3d scene",
        "version": VERSION,
        "units": scene.units,
        "frame": scene.frame,
        "axes": AXES,
        "near_far": list(scene.near_far),
        "inputs_folder": "inputs",
        "height": scene.height,
        "width": scene.width,
        "num_views": len(scene.views),
        "num_objects": len(scene.objects),
        "num_anchors": scene.tokens.assignment.shape[0],
        "num_gaussians": len(scene.gaussians.means),
        "provenance": dataclasses.asdict(scene.provenance),
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
    count = tensors["means"].shape[0]
    coefficients = tensors["sh"].shape[1] if tensors["sh"].ndim == 3 else 0
    shapes = {
        "means": (count, 3), "quats": (count, 4), "scales": (count, 3), "opacities": (count,),
        "sh": (count, coefficients, 3), "anchor_index": (count,),
    }  # fmt: skip
    _check_shapes(file, tensors, shapes)
    if coefficients not in (1, 4, 9, 16):
        raise ValueError(f"{file}: sh has {coefficients} coefficients, not 1, 4, 9 or 16")
    return Gaussians(**tensors)


def _read_tokens(path: Path, digests: dict[str, str]) -> SceneTokens:
    file = path / "tokens.safetensors"
    tensors = _read_tensors(file, digests, SceneTokens)
    num_anchors, num_groups = tensors["positions"].shape[0], tensors["groups"].shape[0]
    shapes = {
        "positions": (num_anchors, 3),
        "anchors": (num_anchors, *tensors["anchors"].shape[1:2]),
        "groups": (num_groups, *tensors["groups"].shape[1:2]),
        "assignment": (num_anchors, num_groups + 1),
    }
    if tensors["anchors"].ndim == 2 and tensors["groups"].ndim == 2:
        shapes["groups"] = (num_groups, tensors["anchors"].shape[1])
    _check_shapes(file, tensors, shapes)
    return SceneTokens(**tensors)


def _read_tensors(file: Path, digests: dict[str, str], kind: type) -> dict[str, Tensor]:
    """The tensors of one file: all that `kind` has, finite, of the right type, whole."""
    if not file.is_file():
        raise FileNotFoundError(f"the scene is incomplete: {file} is missing")
    if sha256_of(file) != digests[file.name]:
        raise ValueError(f"{file} is damaged: it is not the file that scene.json was written for")
    try:
        tensors = load_file(file)
    except (SafetensorError, ValueError) as error:
        raise ValueError(f"{file} is damaged: {error}") from error
    names = {field.name for field in dataclasses.fields(kind)}
    if tensors.keys() != names:
        raise ValueError(f"{file}: wanted the tensors {sorted(names)}, found {sorted(tensors)}")
    for name, value in tensors.items():
        wanted = torch.int64 if name == "anchor_index" else torch.float32
        if value.dtype != wanted or value.ndim == 0:
            raise ValueError(f"{file}: {name} is {value.dtype} {tuple(value.shape)}, not {wanted}")
        if not value.isfinite().all():
            raise ValueError(f"{file}: {name} holds numbers that are not finite")
    return tensors


def _check_shapes(file: Path, tensors: dict[str, Tensor], shapes: dict[str, tuple]) -> None:
    for name, shape in shapes.items():
        if tuple(tensors[name].shape) != tuple(shape):
            raise ValueError(f"{file}: {name} is {tuple(tensors[name].shape)}, wanted {shape}")


def _read_cameras(file: Path) -> tuple[Cameras, tuple[SceneView, ...]]:
    entries = _read_json(file)
    if not isinstance(entries, list) or not 1 <= len(entries) <= MAX_VIEWS:
        raise ValueError(f"{file}: wanted a list of 1 to {MAX_VIEWS} views")
    views = tuple(
        SceneView(str(entry["file"]), str(entry["sha256"]), _pixel_map(file, entry["pixel_map"]))
        for entry in entries
    )
    cam_from_world = _matrices(file, [entry["cam_from_world"] for entry in entries], 4)
    intrinsics = _matrices(file, [entry["intrinsics"] for entry in entries], 3)
    return Cameras(cam_from_world, intrinsics), views


def _pixel_map(file: Path, value: dict[str, Any]) -> PixelMap:
    numbers = {name: float(value[name]) for name in ("scale_x", "scale_y", "offset_x", "offset_y")}
    if not all(math.isfinite(number) for number in numbers.values()):
        raise ValueError(f"{file}: a pixel_map holds a number that is not finite")
    return PixelMap(
        original_height=int(value["original_height"]),
        original_width=int(value["original_width"]),
        exif_orientation=int(value["exif_orientation"]),
        height=int(value["height"]),
        width=int(value["width"]),
        **numbers,
    )


def _matrices(file: Path, rows: list[Any], size: int) -> Tensor:
    try:
        matrices = torch.tensor(rows, dtype=torch.float32)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{file}: a matrix of a camera is not a table of numbers") from error
    if matrices.shape[1:] != (size, size) or not matrices.isfinite().all():
        raise ValueError(f"{file}: a matrix of a camera is not {size} x {size} finite numbers")
    return matrices


def _read_objects(
    file: Path, num_views: int, gaussians: Gaussians, tokens: SceneTokens
) -> tuple[SceneObject, ...]:
    objects = tuple(SceneObject.from_json(entry) for entry in _read_json(file))
    ids = [item.id for item in objects]
    if len(set(ids)) != len(ids) or any(not 1 <= i <= len(tokens.groups) for i in ids):
        raise ValueError(f"{file}: the ids {ids} are not distinct or not those of groups")
    end = 0
    for item in objects:
        start, count = item.gaussian_range
        if start != end or count < 1 or start + count > len(gaussians.means):
            raise ValueError(f"{file}: gaussian_range {start}, {count} of {item.key} cannot be")
        if not all(0 <= view < num_views for view in (*item.visible_in, item.best_view.view)):
            raise ValueError(f"{file}: {item.key} names a view that is not there")
        end = start + count
    return objects


def _near_far(file: Path, value: Any) -> tuple[float, float]:
    numbers = isinstance(value, list) and all(type(number) in (int, float) for number in value)
    if not numbers or len(value) != 2 or not 0 < value[0] < value[1] < math.inf:
        raise ValueError(f"{file}: near_far is {value}; wanted two numbers, 0 < near < far")
    return float(value[0]), float(value[1])


def _read_photos(
    folder: Path, count: int, height: int, width: int
) -> UInt8[Tensor, "view {height} {width} 3"]:
    photos = torch.empty(count, height, width, 3, dtype=torch.uint8)
    for index in range(count):
        file = _photo_path(folder, index)
        if not file.is_file():
            raise FileNotFoundError(f"the scene is incomplete: {file} is missing")
        try:
            with Image.open(file, formats=["PNG"]) as picture:
                if picture.size != (width, height):
                    raise ValueError(f"{file}: size {picture.size}, wanted {(width, height)}")
                photos[index] = torch.from_numpy(np.array(picture.convert("RGB")))
        except OSError as error:
            raise ValueError(f"{file} is damaged: {error}") from error
    return photos


def _photo_path(folder: Path, index: int) -> Path:
    return folder / f"{index:03d}.png"


def _one_of(path: Path, value: Any, choices: tuple[str, ...]) -> Any:
    if value not in choices:
        raise ValueError(f"{path / 'scene.json'}: {value!r} is none of {choices}")
    return value


def _read_json(file: Path) -> Any:
    if not file.is_file():
        raise FileNotFoundError(f"the scene is incomplete: {file} is missing")
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{file} is damaged: {error}") from error


def _write_json(file: Path, value: Any) -> None:
    file.write_text(json_text(value) + "\n", encoding="utf-8")
