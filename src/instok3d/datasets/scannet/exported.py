"""ScanNet as others have exported it: Uni3R's scannet_processed and LSM's test scenes."""

import io
import tarfile
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8, UInt16
from PIL import Image

from instok3d.datasets.poses import pose_fault
from instok3d.datasets.prepared import DroppedFrame, PreparedFrame
from instok3d.datasets.scannet.export import (
    check_intrinsics,
    check_same_view,
    cropped_intrinsics,
)
from instok3d.datasets.scannet.id_maps import read_id_png
from instok3d.datasets.scannet.sens import half_pixel_intrinsics
from instok3d.photos.cropping import crop_about_principal_point, crop_image, crop_values
from instok3d.photos.image_decoding import naming_damage as naming_picture_damage
from instok3d.photos.pixel_map import PixelMap
from instok3d.reading import naming_damage, parse_npy

MOST_BYTES = 2**28
"""Of one file; theirs are pictures and cameras of a few hundred kB."""


class FileTree:
    """Files below a folder or inside a tar archive, by the path below its root.

    Args:
        root: The folder, or a .tar file, which is not unpacked.
        below: A folder inside it that counts as the root.

    Raises:
        ValueError: The archive is damaged or cut off.
    """

    def __init__(self, root: Path, below: str = "") -> None:
        self.root = root
        self._tar: tarfile.TarFile | None = None
        self._below = f"{below}/" if below else ""
        if root.is_dir():
            base = root / below
            names = [p.relative_to(base).as_posix() for p in base.rglob("*") if p.is_file()]
        else:
            names = self._open_tar()
        self.names = frozenset(names)
        """All files."""

    def read(self, name: str) -> bytes:
        """The bytes of one file.

        Raises:
            FileNotFoundError: There is none of this name.
            ValueError: It is cut off.
        """
        if name not in self.names:
            raise FileNotFoundError(f"there is no file {self._below}{name} in {self.root}")
        if self._tar is None:
            return (self.root / self._below / name).read_bytes()
        member = self._members[name]
        if member.size > MOST_BYTES:
            raise ValueError(f"{self.root}: {name} has {member.size} bytes, far too many; leave it")
        with naming_damage(f"{self.root}: {name}", "download it again"):
            stream = self._tar.extractfile(member)
            data = b"" if stream is None else stream.read()
        if len(data) < member.size:
            raise ValueError(f"{self.root} is cut off in {member.name}; download it again")
        return data

    def _open_tar(self) -> list[str]:
        with naming_damage(self.root, "download it again"):
            self._tar = tarfile.open(self.root, "r:")  # noqa: SIM115  open as long as the tree
            members = [member for member in self._tar if member.isfile()]
        with self.root.open("rb") as stream:
            stream.seek(-tarfile.BLOCKSIZE, io.SEEK_END)
            if any(stream.read()):  # tarfile takes an archive cut between two files for whole
                raise ValueError(f"{self.root} is cut off: its end is missing; download it again")
        paths = {member.name.removeprefix("./"): member for member in members}
        self._members = {
            name.removeprefix(self._below): member
            for name, member in paths.items()
            if name.startswith(self._below)
        }
        return list(self._members)


def processed_frames(root: Path, scan: str, *, size: int) -> Iterator[PreparedFrame | DroppedFrame]:
    """Frames of Uni3R's export: {scan}/color/*.png, depth/*.png, pose/*.npz; there are no ids.

    Args:
        root: The folder scannet_processed.
        scan: Name of the scan.
        size: Height and width.

    Raises:
        ValueError: A file is damaged, or does not fit the picture.
    """
    tree = FileTree(root, scan)
    colors = sorted(name for name in tree.names if name.startswith("color/"))
    for color in colors:
        stem = Path(color).stem
        yield _frame(
            tree, stem, size,
            color=color, cameras=f"pose/{stem}.npz", depth=f"depth/{stem}.png", labels=None,
        )  # fmt: skip


def lsm_frames(
    root: Path, scan: str, chosen: Sequence[str] | None, *, size: int
) -> Iterator[PreparedFrame | DroppedFrame]:
    """Frames of LSM's test scenes: {scan}/images/*.jpg and *.npz, depths/*.png, labels/*.png.

    Args:
        root: The folder or scannet_test.tar.
        scan: Path of the scan below it.
        chosen: Its frame ids by selected_seqs_test.json; None takes all.
        size: Height and width.

    Raises:
        ValueError: A file is damaged, or does not fit the picture.
    """
    tree = FileTree(root, scan)
    there = [Path(name).stem for name in tree.names if name.endswith(".jpg")]
    stems = sorted(there if chosen is None else (Path(name).stem for name in chosen), key=_number)
    for stem in stems:
        if f"images/{stem}.jpg" not in tree.names:
            yield DroppedFrame(stem, "no image")
            continue
        yield _frame(
            tree, stem, size,
            color=f"images/{stem}.jpg", cameras=f"images/{stem}.npz",
            depth=f"depths/{stem}.png", labels=f"labels/{stem}.png",
        )  # fmt: skip


def _frame(
    tree: FileTree, stem: str, size: int, *, color: str, cameras: str, depth: str,
    labels: str | None,
) -> PreparedFrame | DroppedFrame:  # fmt: skip
    for name, kind in ((cameras, "camera"), (depth, "depth"), (labels, "labels")):
        if name is not None and name not in tree.names:
            return DroppedFrame(stem, f"no {kind}")
    pose, intrinsics = _cameras(tree, cameras)
    fault = pose_fault(pose)
    if fault:
        return DroppedFrame(stem, fault)
    where = f"{tree.root}: {color}"
    image = _image(tree.read(color), where)
    check_intrinsics(intrinsics, image.height, image.width, f"{tree.root}: {cameras}")
    pixel_map = crop_about_principal_point(
        torch.from_numpy(intrinsics), image.height, image.width, size, size
    )
    return PreparedFrame(
        source=stem,
        image=_cropped(image, pixel_map),
        world_from_cam=pose,
        intrinsics=cropped_intrinsics(intrinsics, pixel_map),
        depth_thousandths=_map(tree, depth, pixel_map),
        labels=None if labels is None else _map(tree, labels, pixel_map),
    )


def _cameras(
    tree: FileTree, name: str
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "3 3"]]:
    what = f"{tree.root}: {name}"
    with naming_damage(what, "download it again"), _zip(tree.read(name)) as archive:
        pose = _array(archive, "camera_pose", what).reshape(4, 4)
        intrinsics = _array(archive, "camera_intrinsics", what)[:3, :3]
    if intrinsics.shape != (3, 3):
        raise ValueError(f"{what} has intrinsics of shape {intrinsics.shape}, wanted 3 x 3")
    return pose, half_pixel_intrinsics(intrinsics)


def _zip(data: bytes) -> zipfile.ZipFile:
    return zipfile.ZipFile(io.BytesIO(data))


def _array(archive: zipfile.ZipFile, name: str, what: str) -> Float[np.ndarray, "*shape"]:
    """A small array of numbers out of an .npz file."""
    with archive.open(f"{name}.npy") as stream:
        data = stream.read(2**16)
    return parse_npy(data, f"{what}, {name}", "download it again").astype(np.float64)


def _image(data: bytes, what: str) -> Image.Image:
    with naming_picture_damage(what):
        image = Image.open(io.BytesIO(data), formats=["JPEG", "PNG"])
        image.load()
    return image


def _cropped(image: Image.Image, pixel_map: PixelMap) -> UInt8[np.ndarray, "height width 3"]:
    return crop_image(image.convert("RGB"), pixel_map)


def _map(tree: FileTree, name: str, pixel_map: PixelMap) -> UInt16[np.ndarray, "height width"]:
    what = f"{tree.root}: {name}"
    height, width = pixel_map.original_height, pixel_map.original_width
    values = read_id_png(tree.read(name), what, height * width)
    check_same_view(values.shape, height, width, what)
    return crop_values(values, pixel_map)


def _number(stem: str) -> tuple[int, str]:
    return (int(stem) if stem.isdecimal() else -1, stem)
