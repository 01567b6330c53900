"""scene.json of a scene folder: what it says of the scene, written and read."""

import dataclasses
from pathlib import Path
from typing import Any

from instok3d.locking import bring_back
from instok3d.reading import number, one_of, read_json, text, whole_number
from instok3d.scene.picture_size import MAX_PICTURE_PIXELS
from instok3d.scene.record import MAX_FAR, CleanUpRecord, Provenance, RefinementRecord, SceneRecord
from instok3d.scene.versions import FROM_GAUSSIANS, VERSION, upgraded
from instok3d.scene.vertical import Vertical

AXES = {
    "first camera": "OpenCV: x right, y down, z forward; quaternions wxyz; pixel centres at +0.5",
    "given cameras": "cameras OpenCV: x right, y down, z forward; the world as they were given in; "
    "quaternions wxyz; pixel centres at +0.5",
    "file": "the world of the imported file; quaternions wxyz",
}
"""By frame."""
FORMAT = "instok3d scene"
REMEDY = "reconstruct the scene again"


def read_header(path: Path) -> dict[str, Any]:
    """scene.json of a folder, as one of today.

    Raises:
        FileNotFoundError: No folder there, or it has no scene.json.
        ValueError: It is of a newer version, or damaged.
    """
    bring_back(path)
    if not path.is_dir():
        raise FileNotFoundError(f"{path} is not a scene folder: no folder of this name is there")
    file = path / "scene.json"
    if not file.is_file():
        raise FileNotFoundError(f"{path} is not a scene folder: it has no scene.json")
    return upgraded(read_json(file, REMEDY), file)


def read_about(header: dict[str, Any]) -> dict[str, Any]:
    """The fields of `SceneRecord` that scene.json holds itself, by name.

    `near_far` is FROM_GAUSSIANS and `vertical` None where an older version did not say.

    Raises:
        KeyError, TypeError, ValueError: A field is missing, of another kind, or out of its range.
    """
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
            hub=text(made.get("hub", "")),
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


def scene_document(scene: SceneRecord, digests: dict[str, str]) -> dict[str, Any]:
    """What scene.json says of a scene.

    Args:
        scene: What is written.
        digests: SHA-256 of its tensor files, by name.
    """
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


def _near_far(value: Any) -> tuple[float, float]:
    near, far = map(number, value)
    if not 0 < near < far <= MAX_FAR:
        raise ValueError(f"near_far is {near:g}, {far:g}; wanted 0 < near < far <= {MAX_FAR:g}")
    return near, far
