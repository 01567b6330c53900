"""Semantics of a scene in files: semantics/ENCODER.safetensors, or tensors of an edit's file."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor

from instok3d.files import sha256_of, write_safetensors
from instok3d.reading import naming_damage
from instok3d.scene.semantics import SceneSemantics, check_encoder

FOLDER = "semantics"
PACKED = "semantics/"
"""How the names of packed tensors begin: semantics/ENCODER/FIELD."""
FIELDS = tuple(field.name for field in dataclasses.fields(SceneSemantics))


def write_semantics(folder: Path, semantics: Mapping[str, SceneSemantics]) -> dict[str, str]:
    """Write a file for each encoder into a scene's folder; the SHA-256 of each, by encoder."""
    digests = {}
    for encoder, one in sorted(semantics.items()):
        file = folder / FOLDER / f"{check_encoder(encoder)}.safetensors"
        file.parent.mkdir(exist_ok=True)
        write_safetensors(file, _halves(one))
        digests[encoder] = sha256_of(file)
    return digests


def read_semantics(
    folder: Path, digests: Mapping[str, str], remedy: str, *, groups: int, anchors: int
) -> dict[str, SceneSemantics]:
    """The semantics in a scene's folder.

    Args:
        folder: Of the scene.
        digests: SHA-256 of the file of each encoder that the scene has.
        remedy: What to do about damage, for messages.
        groups: Of the scene.
        anchors: Of the scene.

    Raises:
        FileNotFoundError: A file is missing.
        ValueError: One is damaged, or does not fit the scene.
    """
    found = {}
    for encoder, digest in digests.items():
        file = folder / FOLDER / f"{check_encoder(encoder)}.safetensors"
        if not file.is_file():
            raise FileNotFoundError(f"the scene is incomplete: {file} is missing")
        if sha256_of(file) != digest:
            raise ValueError(
                f"{file} is damaged: it is not the file that scene.json was written for"
            )
        with naming_damage(file, remedy):
            found[encoder] = _checked(load_file(file), groups, anchors)
    return found


def packed(semantics: Mapping[str, SceneSemantics]) -> dict[str, Tensor]:
    """The tensors of all encoders under names of their own."""
    return {
        f"{PACKED}{encoder}/{name}": value
        for encoder, one in semantics.items()
        for name, value in _halves(one).items()
    }


def unpacked(
    tensors: Mapping[str, Tensor], *, groups: int, anchors: int
) -> dict[str, SceneSemantics]:
    """The semantics that were packed.

    Raises:
        ValueError: A name that is none, or tensors that do not fit so many groups and anchors.
    """
    by_encoder: dict[str, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        encoder, _, field = name.removeprefix(PACKED).partition("/")
        by_encoder.setdefault(check_encoder(encoder), {})[field] = value
    return {encoder: _checked(each, groups, anchors) for encoder, each in by_encoder.items()}


def _halves(one: SceneSemantics) -> dict[str, Tensor]:
    return {name: value.half() for name, value in vars(one).items()}


def _checked(tensors: Mapping[str, Tensor], groups: int, anchors: int) -> SceneSemantics:
    if set(tensors) != set(FIELDS):
        raise ValueError(f"wanted the tensors {sorted(FIELDS)}, found {sorted(tensors)}")
    shared, residual_map = tensors["shared"], tensors["residual_map"]
    basis = shared.shape[1] if shared.ndim == 3 else 0
    features = shared.shape[2] if shared.ndim == 3 else 0
    residual = residual_map.shape[-1] if residual_map.ndim == 2 else 0
    shapes = {
        "shared": (groups, basis, features),
        "residuals": (anchors, residual),
        "mixing": (anchors, basis),
        "residual_map": (features, residual),
    }
    for name, shape in shapes.items():
        value = tensors[name]
        if value.dtype != torch.float16 or tuple(value.shape) != shape or 0 in shape[1:]:
            found = f"{value.dtype} {tuple(value.shape)}"
            raise ValueError(f"{name} is {found}, wanted torch.float16 {shape}")
        if not value.isfinite().all():
            raise ValueError(f"{name} holds numbers that are not finite")
    return SceneSemantics(**{name: tensors[name].float() for name in FIELDS})
