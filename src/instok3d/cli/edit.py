"""`instok3d edit`: objects of a scene removed, moved, inserted, merged; undone and redone."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene

Operation = Literal[
    "remove", "only", "move", "rotate", "scale", "insert", "duplicate", "recolor", "merge",
    "split", "rename", "hide", "show", "up", "undo", "redo", "log",
]  # fmt: skip
Place = tuple[float, float, float]


@dataclass(frozen=True)
class Options:
    """What operations take besides objects."""

    by: Place | None = None
    """move, duplicate: how far, along x y z of the world, scene units."""
    yaw: float | None = None
    """rotate, move, duplicate, insert: degrees about up, counter-clockwise seen from above."""
    factor: float | None = None
    """scale, move, duplicate, insert: of lengths, above 0."""
    at: Place | None = None
    """insert: where the middle of its base comes to be, x y z."""
    on: str | None = None
    """insert: an object of this scene on which it stands."""
    color: str | None = None
    """recolor: a name such as red, or #rrggbb."""
    box: tuple[float, float, float, float, float, float] | None = None
    """split: lowest x y z and highest x y z of what becomes a new object."""
    claim: bool | None = None
    """remove: take the halo at the rim of the object along (yes, unless False is given)."""
    direction: tuple[str, ...] | None = None
    """up: an axis such as z (-y: --direction=-y), or x y z."""
    fill: Literal["plane"] | None = None
    """remove: extend floors, walls and table tops into the hole, and say that it is invented."""


TAKES: dict[str, tuple[str, ...]] = {
    "remove": ("claim", "fill"), "move": ("by", "yaw", "factor"), "rotate": ("yaw",),
    "scale": ("factor",), "insert": ("at", "on", "yaw", "factor"),
    "duplicate": ("by", "yaw", "factor"), "recolor": ("color",), "split": ("box",),
    "up": ("direction",),
}  # fmt: skip
MANY = ("remove", "only", "merge", "hide", "show")
"""Operations that take several objects."""
NEEDS = {"rotate": "yaw", "scale": "factor", "duplicate": "by", "recolor": "color",
         "up": "direction"}  # fmt: skip


def run(
    scene: tyro.conf.Positional[Path],
    operation: tyro.conf.Positional[Operation],
    objects: tyro.conf.Positional[tuple[str, ...]] = (),
    /,
    options: tyro.conf.OmitArgPrefixes[Options] = Options(),
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    overwrite: bool = False,
    certify: bool = False,
    disclose: Path | None = None,
    json: bool = False,
) -> None:
    """Edit objects of a scene; the source stays, and every edit can be undone.

    Objects are named by id, key (chair#3) or label, in a scene with semantics in words too ("all
    chairs"); of another scene as other.itk:7. rename takes an object and its new label; up changes
    what turns, orbits and exports take for it. log prints what was done.

    Args:
        scene: A scene folder; its log grows unless --output is given.
        operation: What to do.
        objects: What with.
        options: What some operations take.
        output: Another scene folder to write, with its source and log; this one stays.
        overwrite: Replace a scene that is already there.
        certify: Draw before and after from all input views, and print the largest difference
            outside of what was edited, which must be 0.
        disclose: A text file to write: a statement of what was edited.
        json: Print one JSON object.
    """
    from contextlib import nullcontext

    from instok3d.cli.progress import plain_warnings
    from instok3d.scene.edits.folder import editing, keep_log
    from instok3d.scene.files import check_target
    from instok3d.scene.previews import save_with_previews, write_previews_anew
    from instok3d.scene.scene import Scene

    check_arguments(operation, objects, options)
    if output is not None:
        check_target(output, overwrite=overwrite)
    in_place = output is None and operation != "log"
    with plain_warnings(), editing(scene) if in_place else nullcontext():
        before = Scene.load(scene)
        after = before if operation == "log" else edit(before, operation, objects, options)
        difference = certificate(before, after) if certify else None
        if output is not None:
            save_with_previews(after, output, overwrite=overwrite)
        elif in_place and after.history is not None:
            keep_log(scene, after.history)
            write_previews_anew(after, scene)
    if disclose is not None:
        write_statement(after, disclose, overwrite=overwrite)
    report(before, after, output or scene, operation, difference, json=json)
    if difference is not None and difference["outside"] != 0:
        raise ValueError(
            f"pixels outside of what was edited differ by {difference['outside']:.3g}: this is a "
            "fault in the program, please report it"
        )


def check_arguments(operation: str, objects: tuple[str, ...], options: Options) -> None:
    """Refuse options that an operation does not take, and one that lacks what it needs.

    Raises:
        ValueError: Says which.
    """
    taken = TAKES.get(operation, ())
    for field in fields(options):
        if getattr(options, field.name) is not None and field.name not in taken:
            owners = ", ".join(name for name, each in TAKES.items() if field.name in each)
            raise ValueError(f"--{field.name} is no option of {operation}, but of: {owners}")
    needed = NEEDS.get(operation)
    if needed is not None and getattr(options, needed) is None:
        raise ValueError(f"{operation} needs --{needed}")
    if operation == "move" and (options.by, options.yaw, options.factor) == (None, None, None):
        raise ValueError("move needs --by, --yaw or --factor")
    many = operation in MANY
    wanted = 0 if operation in ("up", "undo", "redo", "log") else 2 if operation == "rename" else 1
    if len(objects) < wanted or (len(objects) > wanted and not many):
        what = {0: "no objects", 1: "one object", 2: "an object and a label"}[wanted]
        what = "at least one object" if many else what
        raise ValueError(f"{operation} takes {what}, got {', '.join(objects) or 'none'}")


def edit(
    scene: "Scene", operation: Operation, objects: tuple[str, ...], options: Options
) -> "Scene":
    """The scene after one operation.

    Raises:
        KeyError, ValueError, FileNotFoundError: See `instok3d.scene.edits.editable`.
    """
    from instok3d.cli.targets import object_by_words, objects_by_words

    named: list[int] = []
    if operation in MANY:
        named = [found for each in objects for found in objects_by_words(scene, each)]
    elif operation != "insert" and objects:  # whose object is another scene's
        named = [object_by_words(scene, objects[0])]
    yaw, factor = options.yaw or 0.0, 1.0 if options.factor is None else options.factor
    by = options.by or (0.0, 0.0, 0.0)
    box = None if options.box is None else (options.box[:3], options.box[3:])
    ways: dict[str, Callable[[], Scene]] = {
        "remove": lambda: scene.remove(*named, claim=options.claim is not False, fill=options.fill),
        "only": lambda: scene.only(*named),
        "move": lambda: scene.move(named[0], by, yaw=yaw, scale=factor),
        "rotate": lambda: scene.move(named[0], yaw=yaw),
        "scale": lambda: scene.move(named[0], scale=factor),
        "insert": lambda: _insert(scene, objects[0], options),
        "duplicate": lambda: scene.duplicate(named[0], by, yaw=yaw, scale=factor),
        "recolor": lambda: scene.recolor(named[0], options.color or ""),
        "merge": lambda: scene.merge(*named),
        "split": lambda: scene.split(named[0], box=box),
        "rename": lambda: scene.rename(named[0], objects[1]),
        "hide": lambda: scene.hide(*named),
        "show": lambda: scene.show(*named),
        "up": lambda: scene.with_up(options.direction or ""),
        "undo": scene.undo,
        "redo": scene.redo,
    }
    return ways[operation]()


def _insert(scene: "Scene", origin: str, options: Options) -> "Scene":
    from instok3d.cli.targets import object_by_words
    from instok3d.scene.scene import Scene

    path, colon, name = origin.rpartition(":")
    if not colon or not path or not name:
        raise ValueError(f"insert takes a scene and an object, such as other.itk:7, got {origin!r}")
    on = None if options.on is None else object_by_words(scene, options.on)
    other = Scene.load(path)
    return scene.insert(
        other, object_by_words(other, name), options.at, on=on, yaw=options.yaw or 0.0,
        scale=options.factor,
    )  # fmt: skip


def certificate(before: "Scene", after: "Scene") -> dict[str, float]:
    """The largest difference outside of what was edited, from all input views or from around."""
    from dataclasses import asdict

    from instok3d.scene.edits.certify import certify
    from instok3d.scene.paths import orbit

    cameras = before.cameras if before.views else orbit(before, 8)
    return asdict(certify(before, after, cameras, before.height, before.width))


def write_statement(scene: "Scene", file: Path, *, overwrite: bool) -> None:
    """Write what was edited, in words, as a text file."""
    from instok3d.cli.targets import check_file
    from instok3d.files import replacing
    from instok3d.scene.edits.disclosure import statement

    check_file(file, overwrite=overwrite, endings=(".txt", ".md"))
    with replacing(file, overwrite=overwrite) as part:
        part.write_text(statement(scene) + "\n", encoding="utf-8")


def report(
    before: "Scene",
    after: "Scene",
    path: Path,
    operation: str,
    difference: dict[str, float] | None,
    *,
    json: bool,
) -> None:
    """Say what was done, and what objects are new."""
    from instok3d.cli.info import print_json

    known = {item.id for item in before.objects}
    new = [item.key for item in after.objects if item.id not in known]
    undone = [] if after.history is None else [each.name for each in after.history.undone]
    if json:
        print_json({
            "scene": str(path), "edits": list(after.edits), "undone": undone, "new": new,
            "source_sha256": after.provenance.edited_from, "certificate": difference,
        })  # fmt: skip
        return
    if operation == "log":
        lines = [f"{number:4} {words}" for number, words in enumerate(after.edits, 1)]
        lines += [f"     undone: {name}" for name in undone]
        print("\n".join(lines) if lines else "no edits")
        return
    done = len(after.edits) - len(before.edits)
    for words in after.edits[len(before.edits) :] if done > 0 else ():
        print(words)
    edits = f"{len(after.edits)} edit{'s' if len(after.edits) != 1 else ''}"
    print(f"{edits}, {len(after.objects)} objects; written to {path}")
    if difference is not None:
        share = difference["pixels_outside"] / max(1, difference["pixels"])
        print(
            f"largest difference in the {share:.1%} of the pixels outside of what was edited: "
            f"{difference['outside']:g}"
        )
