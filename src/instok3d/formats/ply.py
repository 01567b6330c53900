"""Gaussians as the PLY files of 3D Gaussian Splatting, which every splat viewer opens."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, Num
from torch import Tensor

from instok3d.files import replacing
from instok3d.formats.compressed_ply import PACKED, read_compressed
from instok3d.formats.group_columns import group_ids
from instok3d.formats.ply_tables import Element, read_header, read_table
from instok3d.formats.registry import ExportOptions
from instok3d.formats.splats import LOGIT_LIMIT, SCALES, Splats, drawable_splats
from instok3d.formats.statements import scene_comments, stated_units, stated_up
from instok3d.scene.scene import Scene
from instok3d.types import Gaussians

OPACITY_LIMIT = 1e-6
"""Opacities are written this far from 0 and 1, where the logit is infinite."""
NEEDED = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
          "rot_0", "rot_1", "rot_2", "rot_3"]  # fmt: skip


def write_ply(
    path: Path,
    gaussians: Gaussians,
    *,
    sh_degree: int = 3,
    object_ids: Int[Tensor, " gaussian"] | None = None,
    comments: tuple[str, ...] = (),
    overwrite: bool = True,
) -> None:
    """Write unbatched Gaussians in their order, atomically.

    Log scales, logit opacities, quaternions wxyz, colour as f_dc and channel-major f_rest, in
    OpenCV axes as they are. Bands that the Gaussians lack are zeros: many readers know only
    degree 0 and 3. Bands above `sh_degree` are left out.

    Args:
        path: Where to; its folder must exist.
        gaussians: Unbatched.
        sh_degree: Degree of the file, 0 to 3.
        object_ids: Written as one more float column `object_id`; readers with a fixed layout
            refuse such files.
        comments: Lines for the header.
        overwrite: Replace a file that is there.

    Raises:
        FileExistsError: A file is there, and overwrite is off.
        ValueError: sh_degree is not in 0..3 or a comment holds a line break.
    """
    if sh_degree not in (0, 1, 2, 3):
        raise ValueError(f"sh_degree must be 0, 1, 2 or 3, got {sh_degree}")
    if any("\n" in line or "\r" in line for line in comments):
        raise ValueError("a PLY comment must be one line")
    columns = _columns(gaussians, sh_degree)
    if object_ids is not None:
        columns["object_id"] = object_ids.cpu().numpy()
    count = gaussians.means.shape[0]
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments)]
    header += [f"element vertex {count}", *(f"property float {name}" for name in columns)]
    rows = np.stack([np.asarray(column, "<f4") for column in columns.values()], axis=1)
    with replacing(path, overwrite=overwrite) as part, part.open("wb") as stream:
        stream.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii", "replace"))
        stream.write(np.ascontiguousarray(rows).tobytes())


def write_scene_ply(path: Path, scene: Scene, options: ExportOptions) -> None:
    """Write a scene's Gaussians, sorted by object; see `write_ply`."""
    write_ply(
        path, scene.gaussians, sh_degree=options.sh_degree,
        object_ids=scene.object_ids() if options.with_ids else None,
        comments=scene_comments(scene), overwrite=options.overwrite,
    )  # fmt: skip


def read_ply(path: Path) -> Splats:
    """The Gaussians of a 3DGS PLY file, binary of either byte order or ASCII, of degree 0 to 3.

    A compressed PLY is known by its columns, whatever it is called.

    The header is checked against the file's size before anything is allocated. An infinite logit
    is full or no opacity, a scale of 0 becomes a tiny one. Groups come from a column such as
    object_id (`group_columns.COLUMNS`), or from the features of Gaussian Grouping where its
    classifier lies beside the file.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not a PLY of Gaussians, or its size is wrong.
    """
    header = read_header(path)
    element = header.element("vertex")
    if element is None:
        found = ", ".join(each.name[:40] for each in header.elements[:10]) or "nothing"
        raise ValueError(f"{path} holds no Gaussians: wanted the element 'vertex', found: {found}")
    if PACKED[0] in element.names:
        return read_compressed(path, header)
    num_rest = _num_rest(path, element)
    rows = read_table(path, header, element)
    ids, notes = group_ids(path, rows)
    with np.errstate(over="ignore"):  # of double columns; those rows are dropped
        opacities = _table(rows, ["opacity"])[:, 0].clamp(-LOGIT_LIMIT, LOGIT_LIMIT).sigmoid()
        rest = _table(rows, [f"f_rest_{i}" for i in range(num_rest)])
        rest = rest.reshape(len(rows), 3, num_rest // 3).mT
        return drawable_splats(
            path,
            means=_table(rows, NEEDED[:3]),
            quats=_table(rows, NEEDED[10:14]),
            scales=_scales(_table(rows, NEEDED[7:10])),
            opacities=opacities,
            sh=torch.cat([_table(rows, NEEDED[3:6])[:, None], rest], dim=1),
            object_ids=ids,
            up=stated_up(header.comments),
            units=stated_units(header.comments),
            notes=notes,
        )


def _scales(logarithms: Float[Tensor, "gaussian 3"]) -> Float[Tensor, "gaussian 3"]:
    """Not finite where a logarithm is none, unless it is that of 0."""
    return logarithms.exp().where(logarithms < torch.inf, torch.nan)


def _num_rest(path: Path, element: Element) -> int:
    """Number of the columns f_rest_*, once all that are needed are known to be there."""
    names = element.names
    num_rest = sum(name.startswith("f_rest_") for name in names)
    if num_rest not in (0, 9, 24, 45):
        raise ValueError(f"{path}: {num_rest} columns f_rest_*; wanted 0, 9, 24 or 45")
    wanted = [*NEEDED, *(f"f_rest_{i}" for i in range(num_rest))]
    missing = [name for name in wanted if name not in names]
    if missing:
        raise ValueError(f"{path} holds no Gaussians: missing columns {missing[:5]}")
    return num_rest


def _table(rows: np.ndarray, names: Sequence[str]) -> Tensor:
    """Some columns as float32, row by row."""
    table = torch.empty(len(rows), len(names))
    for index, name in enumerate(names):
        table[:, index] = torch.from_numpy(rows[name].astype(np.float32))
    return table


def _columns(gaussians: Gaussians, sh_degree: int) -> dict[str, Num[np.ndarray, " gaussian"]]:
    """Column name -> values, in the order of the reference implementation."""
    means, sh = gaussians.means.detach().cpu().numpy(), gaussians.sh.detach().cpu()
    rest = sh.new_zeros(sh.shape[0], 15, 3)
    rest[:, : sh.shape[1] - 1] = sh[:, 1:]
    count = (sh_degree + 1) ** 2 - 1
    # Channel-major: all coefficients of red, then green, then blue.
    rest = rest[:, :count].mT.reshape(sh.shape[0], 3 * count).numpy()
    opacities = gaussians.opacities.detach().cpu().double()
    logits = opacities.clamp(OPACITY_LIMIT, 1 - OPACITY_LIMIT).logit().numpy()
    log_scales = gaussians.scales.detach().cpu().clamp(*SCALES).log().numpy()
    quats = gaussians.quats.detach().cpu().numpy()
    normals = np.zeros(len(means))
    columns = {name: means[:, i] for i, name in enumerate("xyz")}
    columns |= dict.fromkeys(("nx", "ny", "nz"), normals)
    columns |= {f"f_dc_{i}": sh[:, 0, i].numpy() for i in range(3)}
    columns |= {f"f_rest_{i}": rest[:, i] for i in range(3 * count)}
    columns |= {"opacity": logits}
    columns |= {f"scale_{i}": log_scales[:, i] for i in range(3)}
    columns |= {f"rot_{i}": quats[:, i] for i in range(4)}
    return columns
