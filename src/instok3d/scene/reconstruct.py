"""The main job: photos in, a scene of objects out."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from instok3d.backbones.base import GeometryBackbone
from instok3d.backbones.cost import Work
from instok3d.files import sha256_of
from instok3d.model.files import DEFAULT_MODEL, load_model, read_card, read_sizes
from instok3d.model.memory import check_memory
from instok3d.model.tokenizer import Tokenizer
from instok3d.model.views.unseeded import without_patches
from instok3d.photos.loading import PhotoSet, read_photos
from instok3d.refinement.settings import DEFAULT_STEPS, RefinementSettings
from instok3d.scene.checked_geometry import checked_geometry
from instok3d.scene.clean_up import cleaned
from instok3d.scene.from_tokens import bare_scene, with_objects
from instok3d.scene.geometry_source import GeometrySource, find_source
from instok3d.scene.hub_model import ModelFile, find_model
from instok3d.scene.lifting import AUTO, find_lifting
from instok3d.scene.record import Provenance, SceneView
from instok3d.scene.refine import refined
from instok3d.scene.scene import Scene
from instok3d.scene.vertical import given_up
from instok3d.version import generator

TRAINED_ON_ROOMS = (
    "the default model was trained on rendered rooms alone: of real photos it finds fewer objects "
    "whole and blurs more (figures: docs/results.md, Captures of real rooms)"
)
IMAGE_SIDE = 128
"""Pixels of a square view, for models whose card does not say `image_side`."""
MIN_SIDE, MAX_SIDE = 64, 512
"""Sides of square views that can be asked for, pixels."""


def checked_side(pixels: int, name: str = "pixels (--pixels)") -> int:
    """The side of square views that was asked for, pixels.

    Raises:
        ValueError: It is out of bounds; calls it by the name.
    """
    if not MIN_SIDE <= pixels <= MAX_SIDE:
        raise ValueError(f"{name} must lie in {MIN_SIDE}..{MAX_SIDE}, got {pixels}")
    return pixels


def load(path: str | Path) -> Scene:
    """The scene of a folder that `Scene.save` wrote, or of the hub; see `Scene.load`."""
    return Scene.load(path)


def reconstruct(
    photos: str | Path | Sequence[str | Path],
    *,
    cameras: str | Path | None = None,
    geometry: str | GeometryBackbone = "nano",
    allow_outside: bool = False,
    up: str | Sequence[str | float] | None = None,
    model: str | Path | Tokenizer | None = None,
    seed: int = 0,
    refine: int = DEFAULT_STEPS,
    clean_up: bool = True,
    semantics: str | Path = AUTO,
    teacher: str | None = None,
    max_views: int = 16,
    pixels: int | None = None,
    device: str | torch.device = "cpu",
    progress: Callable[[str], None] | None = None,
    stop: Callable[[], bool] | None = None,
    read_model: Callable[[Path | None], Tokenizer] = load_model,
) -> Scene:
    """A scene of objects from photos of one room. Not differentiable.

    The model's Gaussians are refined on the photos (`instok3d.refine`) and its groups are made
    whole objects (`instok3d.scene.clean_up`), which is not in the paper; `refine=0` and
    `clean_up=False` leave them as the single forward pass gives them.

    With the nano backbone (that of the default model) photos that match none of the others, or
    whose matches fit no camera, are left out. The scene's warnings name them, and say which cameras
    few matches confirm, or if given cameras contradict the photos.

    Same files, model and seed on the same machine, with as many threads, give the same scene.

    Args:
        photos: A folder, files, a pattern or a video; or a folder with photos in subfolders and
            their cameras beside them.
        cameras: Known cameras, and depth where it is there: a COLMAP folder, transforms.json or
            scene.json. The scene is then in their world and units; otherwise in the frame of
            the first photo's camera and in arbitrary units.
        geometry: Where cameras and depth come from. "nano": the model's own backbone (nano in the
            default model), which keeps what is given. "vggt-1b", "da3-small", "da3-base": that
            network, whose answer the model takes as if it were given. "colmap": cameras by COLMAP
            (needs pycolmap) from the whole photos, with the own backbone's depth fitted to its
            points. "given": as "nano", but without cameras refused. "auto": what is given, else
            the best network whose weights are on this machine; a note says which. Or a backbone.
        allow_outside: Let the camera file name photos and depth outside of its folder.
        up: Which way is up in the scene's world, an axis such as "z" or three numbers; None
            estimates it.
        model: A model file, hub:USER/NAME@REVISION, or a model; the default model when None.
        seed: Seeds torch for the run; the caller's random state is left as it was.
        refine: Steps of refinement at the size that the model sees; 0 for none. `instok3d.refine`
            refines a scene further, at more pixels too.
        clean_up: Join groups that hold one thing, and give loose pieces to what surrounds them.
        semantics: What names the objects and lets them be searched: "auto", the encoder that comes
            with the default model or with one of the hub; "none"; or a file that `train export`
            wrote for this model.
        teacher: The 2D encoder of that file, such as "lseg:FILE", where the file does not hold it.
        max_views: Of more photos, this many are chosen to cover all.
        pixels: Height and width at which the model sees the photos, a multiple of its patch size;
            None takes that of its training. More gives more anchors, which takes longer.
        device: Where the model runs; the scene comes back on the CPU.
        progress: Called with the name of each stage as it begins, and behind a colon with how far
            it is.
        stop: Asked before every step of refinement; True ends it there.
        read_model: What reads the model's file; one that keeps models saves time over many scenes.

    Raises:
        FileNotFoundError: Something named is not there; MissingWeightsError for the model or the
            geometry.
        ModuleNotFoundError: geometry is "colmap", and pycolmap is not installed.
        PermissionError: Something may not be read.
        ValueError: No photo, a damaged one, or cameras that do not fit; says which. Or
            COLMAP registers no two photos. Or the device or the seed cannot be used.
        NotEnoughMemoryError: So many views are predicted not to fit; says how many would.
    """
    begin = progress or (lambda stage: None)
    refinement = RefinementSettings(steps=refine, seed=seed)
    device = _checked_device(device)
    if not 0 <= seed < 2**63:
        raise ValueError(f"seed must lie in 0..2^63 - 1, got {seed}")
    vertical = None if up is None else given_up(up)
    source, choice_notes = find_source(geometry, posed=cameras is not None)
    begin("photos")
    in_memory = isinstance(model, Tokenizer)
    found = ModelFile(None) if isinstance(model, Tokenizer) else find_model(model)
    path = found.path
    card = {} if in_memory else read_card(path)
    side = int(card.get("image_side", IMAGE_SIDE)) if pixels is None else checked_side(pixels)
    photo_set = read_photos(
        photos, height=side, width=side, max_views=max_views, cameras=cameras,
        allow_outside=allow_outside,
    )  # fmt: skip
    begin("model")
    if not in_memory:
        work = Work(photo_set.views.images.shape[1], side, side)
        check_memory(
            *read_sizes(path), work, device=device, advice="give max_views (--max-views)",
            first=source.work(work.views) if isinstance(source, GeometrySource) else None,
        )  # fmt: skip
    tokenizer = model if isinstance(model, Tokenizer) else read_model(path)
    if side % tokenizer.backbone.patch_size:
        raise ValueError(
            f"pixels (--pixels) must be a multiple of the {tokenizer.backbone.patch_size} pixels "
            f"of the model's patches, got {side}"
        )
    if semantics == AUTO and found.semantics is not None:
        semantics = found.semantics
    lifting = find_lifting(semantics, tokenizer, default=model is None, teacher=teacher)
    tokenizer = tokenizer.to(device).eval()
    with torch.random.fork_rng(), torch.no_grad():
        torch.manual_seed(seed)
        begin("geometry")
        checked = checked_geometry(
            tokenizer.backbone, photo_set, device, source, lambda text: begin(f"geometry: {text}")
        )
        begin("tokens")
        photo_set = checked.photos
        views = photo_set.views.to(device)
        features = None if lifting is None else lifting.features(views)
        lift = None
        if lifting is not None and features is not None:
            lift = lifting.of(tokenizer, views, features)
        tokens = tokenizer(views, checked.geometry, lift).to("cpu")
        if checked.unsure_patches is not None:
            tokens = without_patches(tokens, checked.unsure_patches)
    notes = choice_notes + ([TRAINED_ON_ROOMS] if model is None else [])
    for note in [*notes, *checked.notes]:
        warnings.warn(note, stacklevel=2)
    file = path or DEFAULT_MODEL
    given = photo_set.views.cam_from_world
    scene = bare_scene(
        tokens,
        _bytes(photo_set.views.images[0]),
        _scene_views(photo_set),
        provenance=Provenance(
            generator=generator(),
            model="in memory" if in_memory else found.name or str(card.get("name", file.stem)),
            model_sha256="" if in_memory else sha256_of(file),
            seed=seed,
            geometry=checked.source,
            geometry_sha256="" if source is None else source.sha256,
        ),
        cam_from_world=None if given is None else given[0],
        units=photo_set.units,
        notes=[*notes, *photo_set.warnings, *checked.notes],
    )
    if vertical is not None:
        scene = replace(scene, vertical=vertical)
    if lifting is not None:
        scene = lifting.with_semantics(scene, tokens)
    if refine:
        begin("refinement")
        scene = refined(scene, refinement, progress=progress, stop=stop)
    begin("objects")
    scene = with_objects(cleaned_scene(scene) if clean_up else scene)
    if lifting is None or features is None:
        return scene
    return lifting.named(lifting.fitted(scene, features[0]) if refine else scene)


def cleaned_scene(scene: Scene) -> Scene:
    """The scene with whole objects (`clean_up.cleaned`), before its objects are described."""
    near, far = scene.near_far
    done = cleaned(
        scene.gaussians, scene.tokens, scene.cameras, scene.height, scene.width, near=near, far=far
    )
    provenance = replace(scene.provenance, clean_up=done.record)
    return replace(scene, gaussians=done.gaussians, tokens=done.tokens, provenance=provenance)


def _checked_device(name: str | torch.device) -> torch.device:
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise ValueError(f"device {name!r} is none that torch knows; try 'cpu'") from error
    if device.type == "cuda" and not torch.cuda.is_available():
        raise ValueError(f"device {str(name)!r} was asked for, but torch sees no CUDA device")
    return device


def _scene_views(photos: PhotoSet) -> list[SceneView]:
    rows = zip(photos.names, photos.sha256, photos.pixel_maps, strict=True)
    return [SceneView(name, digest, pixel_map) for name, digest, pixel_map in rows]


def _bytes(images: Float[Tensor, "view 3 height width"]) -> UInt8[Tensor, "view height width 3"]:
    return (images * 255).round().clamp(0, 255).to(torch.uint8).permute(0, 2, 3, 1).contiguous()
