"""The tensors of a scene folder, read and checked: gaussians.safetensors, tokens.safetensors."""

import dataclasses
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor

from instok3d.files import sha256_of
from instok3d.reading import naming_damage
from instok3d.scene.header import REMEDY
from instok3d.scene.record import SceneTokens
from instok3d.types import Gaussians, check_gaussians

TENSOR_FILES = {"gaussians.safetensors": Gaussians, "tokens.safetensors": SceneTokens}


def read_gaussians(path: Path, digests: dict[str, str]) -> Gaussians:
    """The Gaussians of a scene folder.

    Args:
        path: The scene folder.
        digests: SHA-256 of its tensor files, by name.

    Raises:
        FileNotFoundError, ValueError: As `load_record`.
    """
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


def read_tokens(path: Path, digests: dict[str, str]) -> SceneTokens:
    """The tokens of a scene folder.

    Args:
        path: The scene folder.
        digests: SHA-256 of its tensor files, by name.

    Raises:
        FileNotFoundError, ValueError: As `load_record`.
    """
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
