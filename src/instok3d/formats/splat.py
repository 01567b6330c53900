"""The .splat files of antimatter15's viewer: 32 bytes for each Gaussian, colours without view."""

from pathlib import Path

import numpy as np
import torch

from instok3d.files import replacing
from instok3d.formats.packing import to_unsigned
from instok3d.formats.registry import ExportOptions
from instok3d.formats.splats import Splats, drawable_splats
from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.scene.scene import Scene

ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)])
"""Scales are linear; quaternions wxyz, 128 + 128 q."""


def write_splat(path: Path, scene: Scene, options: ExportOptions) -> None:
    """Write a scene's Gaussians in their order and axes. Only the constant colour is kept.

    Raises:
        FileExistsError: A file is there, and options.overwrite is off.
    """
    gaussians = scene.gaussians.map(lambda tensor: tensor.detach().cpu())
    rows = np.zeros(len(gaussians.means), ROW)
    rows["means"], rows["scales"] = gaussians.means.numpy(), gaussians.scales.numpy()
    rows["rgba"][:, :3] = to_unsigned(0.5 + SH_CONSTANT * gaussians.sh[:, 0].numpy(), 255)
    rows["rgba"][:, 3] = to_unsigned(gaussians.opacities.numpy(), 255)
    rows["quats"] = np.clip(np.rint(128 + 128 * gaussians.quats.numpy()), 0, 255)
    with replacing(path, overwrite=options.overwrite) as part:
        part.write_bytes(rows.tobytes())


def read_splat(path: Path) -> Splats:
    """The Gaussians of a .splat file, of degree 0.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Its size is no multiple of 32 bytes.
    """
    size = path.stat().st_size
    if size % ROW.itemsize:
        raise ValueError(
            f"{path} has {size} bytes, no multiple of {ROW.itemsize}: it is no .splat file or cut "
            "short"
        )
    rows = np.fromfile(path, ROW)
    colors = (rows["rgba"][:, :3] / np.float32(255) - np.float32(0.5)) / np.float32(SH_CONSTANT)
    return drawable_splats(
        path,
        means=torch.from_numpy(rows["means"].copy()),
        quats=torch.from_numpy(rows["quats"].astype(np.float32) - 128),
        scales=torch.from_numpy(rows["scales"].copy()),
        opacities=torch.from_numpy(rows["rgba"][:, 3] / np.float32(255)),
        sh=torch.from_numpy(colors)[:, None],
    )
