"""`instok3d info`: what is in a scene."""

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

if TYPE_CHECKING:
    from instok3d.cli.progress import StageClock
    from instok3d.scene.record import RefinementRecord
    from instok3d.scene.scene import Scene
    from instok3d.scene.semantics import SceneSemantics

MOST_NEIGHBOURS = 3
"""Of an object that are printed, those with whom it shares most first."""


def run(scene: tyro.conf.Positional[Path], /, json: bool = False) -> None:
    """Print what a scene holds, its units and frame, and what it was made with.

    Args:
        scene: A scene folder, or hub:USER/NAME@REVISION as all commands that read scenes take it.
        json: Print one JSON object.
    """
    from instok3d.cli.targets import load_scene

    loaded = load_scene(scene, None)
    if json:
        print_json({"scene": str(scene), **summary(loaded)})
    else:
        print(describe(loaded))


def show_made(
    scene: "Scene", path: Path, clock: "StageClock", *, json: bool, timings: bool
) -> None:
    """Say what a command has made and written, and on stderr how long it took."""
    from instok3d.progress import format_duration

    print(
        clock.report() if timings else f"done in {format_duration(clock.total_s)}", file=sys.stderr
    )
    if json:
        print_json({"scene": str(path), **summary(scene), "timings_s": clock.times_s})
    else:
        print(f"{describe(scene)}\n\nwritten to {path}; look at {path}/previews/contact_sheet.png")


def summary(scene: "Scene") -> dict[str, Any]:
    """The scene in plain values, for --json."""
    from instok3d.scene.object_list import objects_document

    return {
        "views": [view.file for view in scene.views],
        "objects": objects_document(scene, neighbours=scene.neighbours())["objects"],
        "num_gaussians": len(scene.gaussians.means),
        "semantics": {name: one.num_scalars for name, one in scene.semantics.items()},
        "units": scene.units,
        "frame": scene.frame,
        "vertical": asdict(scene.vertical),
        "near_far": list(scene.near_far),
        "height": scene.height,
        "width": scene.width,
        "provenance": asdict(scene.provenance),
        "tokens_give_gaussians": scene.provenance.tokens_give_gaussians,
        "warnings": list(scene.warnings),
    }


def describe(scene: "Scene") -> str:
    """The scene in a few lines for people."""
    from instok3d.scene.objects import counted, whole_first

    made = scene.provenance
    owned = sum(item.num_gaussians for item in scene.objects)
    unit, lengths = ("m", "metres") if scene.units == "metres" else ("units", "arbitrary units")
    lines = [
        f"{len(scene.views)} views of {scene.height} x {scene.width}, "
        f"{counted(scene.objects)}, {len(scene.gaussians.means)} Gaussians "
        f"({owned} of them of objects)",
        f"world: {scene.frame}, {axes(scene)}; lengths in {lengths}",
        f"made by {made.generator} with {made.model} ({made.model_sha256[:12]}), seed {made.seed}",
        *geometry_line(scene),
        *([f"taken from {made.hub}"] if made.hub else []),
        *(refinement_line(each) for each in made.refinements),
        *clean_up_line(scene),
        *edited_line(scene),
        *(semantics_line(name, one) for name, one in scene.semantics.items()),
        *(f"note: {line}" for line in scene.warnings),
    ]
    if scene.objects:
        lines.append("")
        head = f"{'object':12} {'Gaussians':>9} {'sure':>5} {'best view':>9}"
        lines.append(f"{head}  {f'size ({unit})':20}  touches (share of its border)")
    neighbours = scene.neighbours()
    for item in whole_first(scene.objects):
        size = " x ".join(f"{length:.2f}" for length in item.obb.size)
        named = item.label is None or item.key == f"{item.label}#{item.id}"
        name = item.key if named else f"{item.key} {item.label}"
        view = "none" if item.best_view is None else item.best_view.view
        numbers = f"{item.num_gaussians:9} {item.confidence:5.2f} {view:>9}"
        touching = ", ".join(
            f"{each.id} {each.share:.0%}" for each in neighbours[item.id][:MOST_NEIGHBOURS]
        )
        marks = ["hidden"] * item.hidden + ["fragment"] * item.is_fragment
        aside = "; ".join([touching] * bool(touching) + marks)
        lines.append(f"{name:12} {numbers}  {size:20}  {aside}".rstrip())
    return "\n".join(lines)


def geometry_line(scene: "Scene") -> list[str]:
    """Where cameras and depth come from; nothing where the scene does not say."""
    made = scene.provenance
    weights = f" ({made.geometry_sha256[:12]})" if made.geometry_sha256 else ""
    return [f"cameras and depth: {made.geometry}{weights}"] if made.geometry else []


def clean_up_line(scene: "Scene") -> list[str]:
    """What was joined and moved to make whole objects; nothing where that was not done."""
    done = scene.provenance.clean_up
    if done is None:
        return []
    return [f"cleaned up: {done.joined} groups joined others, {done.moved} Gaussians moved"]


def semantics_line(encoder: str, one: "SceneSemantics") -> str:
    """How much is stored of the features of an encoder."""
    groups, basis, features = one.shared.shape
    anchors, residual = one.residuals.shape
    each = f"{features}" if basis == 1 else f"{basis} x {features}"
    mixed = f" + {anchors} x {basis}" if basis > 1 else ""
    return (
        f"semantics: {encoder}, {one.num_scalars} numbers ({groups} groups x {each} + {anchors} "
        f"anchors x {residual}{mixed})"
    )


def edited_line(scene: "Scene") -> list[str]:
    """How many edits were done to which scene; nothing where none was."""
    from instok3d.scene.edits.disclosure import edited_words

    words = edited_words(scene)
    return [words] if words else []


def refinement_line(done: "RefinementRecord") -> str:
    """One optimisation of the Gaussians in words."""
    split = f", {done.split_share:.0%} of the Gaussians split" if done.split_share else ""
    return (
        f"refined, {done.steps} steps on the photos at {done.height} x {done.width}{split}: "
        f"{done.psnr_before:.1f} -> {done.psnr_after:.1f} dB at the photos; the tokens no longer "
        "give these Gaussians"
    )


def axes(scene: "Scene") -> str:
    """The axes of the world, and which way is up as far as that is known."""
    vertical = scene.vertical
    certainty = f"within 15 degrees with probability {vertical.confidence:.2f}"
    up = ", ".join(f"{value:.3g}" for value in vertical.up)
    if vertical.source == "given":
        own = "x right, y down, z forward" if scene.frame == "first camera" else "with its axes"
        return f"{own}; up is ({up}) as it was given"
    if scene.frame == "first camera":
        return f"x right, y down, z forward; -y is up {certainty}"
    if scene.frame == "file":
        return f"with its axes; up is ({up}) {'as it says' * vertical.is_stated or 'by a guess'}"
    if not vertical.is_stated:
        return "with their axes; the cameras do not tell which way is up"
    return f"with their axes; up is ({up}) by how they are turned, {certainty}"


def print_json(value: dict[str, Any]) -> None:
    """One JSON object on stdout, keys in order, finite numbers only."""
    from instok3d.files import json_text

    print(json_text(value, encoding=sys.stdout.encoding or "utf-8"))
