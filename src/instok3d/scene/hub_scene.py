"""Scenes on the hub: the push of a scene folder with a page about it."""

from pathlib import Path

from instok3d.hub.cards import bash, card_text, table
from instok3d.hub.manifest import ALLOWED, Manifest, manifest_of
from instok3d.hub.pushing import Pushed, check_push_target, push
from instok3d.hub.references import HubReference, parse_reference
from instok3d.scene.scene import Scene

SHEET = "previews/contact_sheet.png"
MOST_OBJECTS = 60
"""In the table of the page."""


def push_scene(path: Path, name: str, *, licence: str = "", public: bool = False) -> Pushed:
    """Push a scene folder to the hub, as a data set; see `instok3d.hub.pushing.push`.

    All of the scene goes: its photos at the scene's size, and the scene as it was before its edits.

    Args:
        path: The folder.
        name: hub:USER/NAME.
        licence: Its identifier on the hub, such as cc-by-4.0; empty = none is stated.
        public: Whether a repository that is made is for everybody.

    Raises:
        FileNotFoundError, ValueError: It is no scene, or a damaged one; or the name is none.
        ModuleNotFoundError, PermissionError, ConnectionError: As `push`.
    """
    reference = parse_reference(name)
    check_push_target(reference)
    scene = Scene.load(path)  # what cannot be read is not pushed
    files = scene_files(path)
    manifest = manifest_of("scene", files)
    return push(
        reference, manifest, files, scene_card(scene, manifest, reference, licence), public=public
    )


def scene_files(path: Path) -> dict[str, Path]:
    """The files of a scene folder by their path in it; what is no part of a scene is left out."""
    found = {each.relative_to(path).as_posix(): each for each in path.rglob("*") if each.is_file()}
    return {name: found[name] for name in sorted(found) if ALLOWED["scene"].fullmatch(name)}


def scene_card(scene: Scene, manifest: Manifest, reference: HubReference, licence: str) -> str:
    """The page of a scene: how it is used and made, its objects, hashes."""
    metadata = {
        "license": licence or "other",
        "tags": ["instok3d", "gaussian-splatting", "3d-scene"],
        "viewer": False,
    }
    made, unit = scene.provenance, "m" if scene.units == "metres" else "arbitrary units"
    objects = [
        (item.id, item.label or item.key, " x ".join(f"{length:.2f}" for length in item.obb.size))
        for item in scene.objects[:MOST_OBJECTS]
    ]
    what = f"{len(scene.views)} photos, {len(scene.objects)} objects, {len(scene.gaussians.means)}"
    parts = [
        f"A scene of InsTok3D: {what} Gaussians.",
        *([f"![photos, render, objects]({SHEET})"] if SHEET in manifest.files else []),
        bash(
            "pip install '.[models]'  # in a copy of the repository instok3d",
            f"instok3d import {reference} -o room.itk",
            "instok3d view room.itk",
        ),
        f"Made by {made.generator} with the model {made.model} (SHA-256 `{made.model_sha256}`).",
        *([f"Edited: {'; '.join(made.edits)}."] if made.edits else []),
        *(["## Objects", table(("id", "name", f"size ({unit})"), objects)] if objects else []),
        *(
            ["## Notes", "\n".join(f"- {line}" for line in scene.warnings)]
            if scene.warnings
            else []
        ),
        "## Licence",
        licence or "None is stated: ask whoever pushed it.",
    ]
    return card_text(metadata, reference.repository.split("/")[1], parts, manifest)
