"""A scene whose Gaussians are optimised on its photos: sharper pictures, the same objects."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from instok3d.files import sha256_of
from instok3d.photos.image_decoding import decode_photo
from instok3d.photos.image_files import find_images
from instok3d.photos.pixel_map import PixelMap
from instok3d.refinement.assignment import reassigned
from instok3d.refinement.optimization import Progress, refine_gaussians
from instok3d.refinement.settings import DEFAULT_STEPS, RefinementSettings
from instok3d.scene.from_tokens import with_objects
from instok3d.scene.picture_size import check_picture_size
from instok3d.scene.record import RefinementRecord
from instok3d.scene.scene import Scene
from instok3d.types import Cameras


def refine(
    scene: Scene,
    photos: str | Path | Sequence[str | Path] | None = None,
    *,
    steps: int = DEFAULT_STEPS,
    pixels: int | None = None,
    masks: str | Path | None = None,
    densify: float = 0.0,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Scene:
    """The scene with its Gaussians optimised on its photos, and its objects described anew.

    Anchors, groups, cameras and, without `densify`, the number of Gaussians stay as they are;
    Gaussians at the border of an object that show another one go to that one. The provenance says
    what was done. Not differentiable. See
    `instok3d.refinement.optimization.refine_gaussians` for the steps.

    Args:
        scene: What to refine.
        photos: The photos that it was made from, as `reconstruct` takes them; others among them
            are left aside. None takes the scene's own copies, at the size the model saw.
        steps: Of optimisation; 0 gives the scene back.
        pixels: Height at which the photos are looked at; the scene's own when None. The scene's
            own copies cannot be enlarged: more needs `photos`.
        masks: A folder with a picture for each photo that has pixels to be ignored, named as the
            photo (`a.png` or `a.jpg.png` for `a.jpg`) and of its shape: black is ignored.
        densify: Share of the Gaussians that are split in two where the error stays, at most 1;
            the halves belong to the anchor of the whole.
        seed: Of the order in which many views are looked at.
        progress: Called with how far it is.
        stop: Asked before every step; True ends there, and what is there by then is kept.

    Raises:
        FileNotFoundError: A photo of the scene or a mask's folder is not there.
        ValueError: Photos that are not those of the scene, masks that fit none of them, or
            settings out of range.
    """
    settings = RefinementSettings(steps=steps, split_share=densify, seed=seed)
    if not scene.views:
        raise ValueError("this scene was imported and has no photos to be refined on")
    if scene.edits:
        warnings.warn(
            "the scene was edited, and its photos show it as it was before: what was removed or "
            "moved comes back in the colours of other Gaussians; refine it before you edit it",
            stacklevel=2,
        )
    height = scene.height if pixels is None else pixels
    width = max(1, round(scene.width * height / scene.height))
    check_picture_size(height, width)
    if photos is None and height != scene.height:
        raise ValueError(
            f"the scene holds its photos at a height of {scene.height} pixels alone, {height} were "
            "asked for: give the photos that it was made from"
        )
    if steps == 0:
        return scene
    images = cameras = None
    if photos is not None:
        paths = _photos_of(scene, find_images(photos))
        images, cameras = _at_size(scene, paths, height, width)
    known = None if masks is None else _read_masks(scene, Path(masks), height, width)
    return with_objects(
        refined(
            scene, settings, images=images, cameras=cameras, known=known, progress=progress,
            stop=stop,
        )
    )  # fmt: skip


def refined(
    scene: Scene,
    settings: RefinementSettings,
    *,
    images: Float[Tensor, "view 3 height width"] | None = None,
    cameras: Cameras | None = None,
    known: Bool[Tensor, "view height width"] | None = None,
    progress: Callable[[str], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Scene:
    """The scene with refined Gaussians, its objects still described as before.

    Gaussians that show the pixels of another group go to it (`refinement.assignment`).

    Args:
        scene: What to refine.
        settings: How.
        images: Its photos, of any one size; the scene's own copies when None.
        cameras: Of the photos, with intrinsics for this size; the scene's own when None.
        known: Pixels that count; None counts all.
        progress: Called with how far it is.
        stop: Asked before every step.
    """

    def tell(at: Progress) -> None:
        if progress is not None:
            progress(f"refinement: step {at.step} of {at.steps}, {at.psnr:.1f} dB")

    near, far = scene.near_far
    images = scene.photos.permute(0, 3, 1, 2).float() / 255 if images is None else images
    cameras = scene.cameras if cameras is None else cameras
    result = refine_gaussians(
        scene.gaussians, cameras, images, settings, known=known, near=near, far=far,
        progress=tell, stop=stop,
    )  # fmt: skip
    if result.steps < settings.steps:
        warnings.warn(
            f"refinement was ended after {result.steps} of {settings.steps} steps; what was "
            "reached by then is kept",
            stacklevel=2,
        )
    if result.steps == 0:
        return scene
    record = RefinementRecord(
        steps=result.steps, height=images.shape[-2], width=images.shape[-1],
        split_share=settings.split_share, seed=settings.seed,
        psnr_before=result.psnr_before, psnr_after=result.psnr_after,
    )  # fmt: skip
    provenance = scene.provenance
    provenance = replace(provenance, refinements=(*provenance.refinements, record))
    gaussians = reassigned(
        result.gaussians, scene.tokens.assignment, scene.tokens.positions, scene.cameras,
        scene.height, scene.width, near=near, far=far,
    )  # fmt: skip
    return replace(scene, gaussians=gaussians, provenance=provenance)


def _photos_of(scene: Scene, candidates: Sequence[Path]) -> list[Path]:
    """The file of each view, found by its bytes, so that names and folders may differ."""
    by_digest = {sha256_of(path): path for path in candidates}
    missing = [view.file for view in scene.views if view.sha256 not in by_digest]
    if missing:
        raise FileNotFoundError(
            f"{len(missing)} of the scene's {len(scene.views)} photos are not among the "
            f"{len(candidates)} that were given, byte for byte: {', '.join(missing[:5])}"
            f"{' ...' if len(missing) > 5 else ''}; give those that it was made from"
        )
    return [by_digest[view.sha256] for view in scene.views]


def _at_size(
    scene: Scene, paths: list[Path], height: int, width: int
) -> tuple[Float[Tensor, "view 3 {height} {width}"], Cameras]:
    """The photos at another size, and the scene's cameras for it."""
    images, intrinsics = [], []
    for path, view, own in zip(paths, scene.views, scene.cameras.intrinsics, strict=True):
        larger = view.pixel_map.resized(height, width)
        images.append(
            decode_photo(path, height=height, width=width, fit=lambda _, m=larger: m).image
        )
        original = view.pixel_map.intrinsics_to_original(own.double())
        intrinsics.append(larger.intrinsics_to_model(original))
    cameras = Cameras(scene.cameras.cam_from_world, torch.stack(intrinsics).float())
    return torch.stack(images), cameras


def _read_masks(
    scene: Scene, folder: Path, height: int, width: int
) -> Bool[Tensor, "view {height} {width}"]:
    """True where a pixel counts; pixels that a mask does not cover do."""
    if not folder.is_dir():
        raise FileNotFoundError(f"masks: there is no folder {folder}")
    files = {path.name: path for path in sorted(folder.rglob("*")) if path.is_file()}
    known, used = [], set()
    for view in scene.views:
        name = Path(view.file)
        found = [each for each in (f"{name.stem}.png", f"{name.name}.png") if each in files]
        used.update(found)
        if not found:
            known.append(torch.ones(height, width, dtype=torch.bool))
            continue
        known.append(_read_mask(files[found[0]], view.pixel_map, height, width))
    if not used:
        names = ", ".join(view.file for view in scene.views[:3])
        raise ValueError(
            f"masks: no file of {folder} is named as a photo of the scene ({names}, ...); wanted "
            f"{Path(scene.views[0].file).stem}.png"
        )
    unused = sorted(files.keys() - used)
    if unused:
        warnings.warn(
            f"{len(unused)} files of {folder} are named as no photo of the scene and were left "
            f"out: {', '.join(unused[:5])}",
            stacklevel=3,
        )
    return torch.stack(known)


def _read_mask(
    file: Path, photo: PixelMap, height: int, width: int
) -> Bool[Tensor, "{height} {width}"]:
    def placed(mask: PixelMap) -> PixelMap:
        found = (mask.original_height, mask.original_width)
        wanted = (photo.original_height, photo.original_width)
        if found != wanted:
            raise ValueError(
                f"{file} is {found[0]} x {found[1]}, its photo {wanted[0]} x {wanted[1]}; a mask "
                "has the shape of its photo"
            )
        return replace(photo.resized(height, width), exif_orientation=mask.exif_orientation)

    mask = decode_photo(file, height=height, width=width, fit=placed)
    return mask.image.mean(dim=0) > 0.5
