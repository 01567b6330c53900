"""The log of edits in a scene folder: edits.jsonl, and beside it the tensors that edits need.

The first line says format, version, the source's hash, and how many of the following lines are
done; the others were undone and can be redone. Each line is one operation with the ids of its
objects. Tensors lie in edits/, in files named by their SHA-256. docs/formats.md has every field.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, get_type_hints

import torch
from safetensors.torch import load as load_tensors
from torch import Tensor

from instok3d.files import replacing, safetensors_bytes
from instok3d.geometry.moving import Similarity
from instok3d.reading import naming_damage, number, parse_json, text, whole_number
from instok3d.scene.edits.arguments import color, factor
from instok3d.scene.edits.history import History
from instok3d.scene.edits.operations import OPERATIONS, Edit
from instok3d.scene.edits.ownership import Part
from instok3d.scene.names import check_label, check_label_source
from instok3d.scene.record import SceneRecord
from instok3d.scene.run_lengths import RunLengths
from instok3d.scene.semantic_files import PACKED, packed, unpacked
from instok3d.scene.vertical import given_up
from instok3d.types import Gaussians, check_gaussians

LOG, ASSETS = "edits.jsonl", "edits"
FORMAT, VERSION = "instok3d edits", 3
REMEDY = "take the scene without its edits (Scene.load(path, edits=False)), or another copy of it"
MAX_EDITS = 1_000_000
"""Lines of a log; more are taken for damage."""


def write_log(folder: Path, history: History) -> None:
    """Write the log of a history into the folder of its source, whole or not at all.

    Tensors first, then the log; then those that no line names any more go.
    """
    wanted: dict[str, bytes] = {}
    lines = [
        {"format": FORMAT, "version": VERSION, "source": history.source_sha256,
         "done": len(history.edits)},
        *(_line(edit, wanted) for edit in (*history.edits, *history.undone)),
    ]  # fmt: skip
    assets = folder / ASSETS
    if wanted:
        assets.mkdir(exist_ok=True)
    for name, data in wanted.items():
        if not (assets / name).is_file():
            with replacing(assets / name) as part:
                part.write_bytes(data)
    with replacing(folder / LOG) as part:
        rows = (json.dumps(line, allow_nan=False, ensure_ascii=False) for line in lines)
        part.write_text("\n".join(rows) + "\n", encoding="utf-8")
    for file in assets.glob("*.safetensors"):
        if file.name not in wanted:
            file.unlink()


def read_log(folder: Path, source: SceneRecord, source_sha256: str) -> History:
    """The history of a scene folder; one without edits where it has no log.

    Args:
        folder: The scene folder.
        source: What its other files hold.
        source_sha256: Of its gaussians.safetensors.

    Raises:
        FileNotFoundError: A file that the log names is missing.
        ValueError: The log is damaged, of a newer version, of another scene, or holds an operation
            that is not known or cannot be done.
    """
    file = folder / LOG
    begun = History.begin(source, source_sha256)
    if not file.is_file():
        return begun
    rows = file.read_bytes().splitlines()
    if not 1 <= len(rows) <= MAX_EDITS:
        raise ValueError(f"{file} is damaged (it has {len(rows)} lines); {REMEDY}")
    done = _read_header(parse_json(rows[0], f"{file}: line 1", REMEDY), file, source_sha256)
    if done >= len(rows):
        raise ValueError(
            f"{file} is damaged ({len(rows) - 1} edits are there, its first line says {done}); "
            f"{REMEDY}"
        )
    edits = []
    for index, row in enumerate(rows[1:], 2):
        where = f"{file}: line {index}"
        edits.append(_read_edit(parse_json(row, where, REMEDY), where, folder / ASSETS))
    try:
        return begun.replayed(tuple(edits[:done]), tuple(edits[done:]))
    except ValueError as error:
        raise ValueError(f"{file} is damaged ({error}); {REMEDY}") from error


def _read_header(value: Any, file: Path, source_sha256: str) -> int:
    """How many edits are done."""
    with naming_damage(f"{file}: line 1", REMEDY):
        if value["format"] != FORMAT:
            raise ValueError(f"its format is {value['format']!r}, not {FORMAT!r}")
        version = whole_number(value["version"], 1)
        if version > VERSION:
            raise ValueError(
                f"{file}: line 1: this program reads logs of version {VERSION}, not {version}; use "
                "a newer program"
            )
        if text(value["source"]) != source_sha256:
            raise ValueError("it belongs to another scene, whose Gaussians are not these")
        return whole_number(value["done"])


def _read_edit(value: Any, where: str, assets: Path) -> Edit:
    with naming_damage(where, REMEDY):
        name = text(value["edit"])
        if name not in OPERATIONS:
            raise ValueError(
                f"{where}: there is no operation {name!r}; this program knows "
                f"{', '.join(OPERATIONS)}: use a newer program"
            )
        kind: Any = OPERATIONS[name]
        wanted = _kinds(kind)
        extra = set(value) - set(wanted) - {"edit"}
        if extra:
            raise ValueError(f"unknown keys {sorted(extra)}")
        # Logs of older versions lack what has a default: version 1 knew no fill.
        lacking = {each.name for each in fields(kind) if each.default is not MISSING} - set(value)
        return kind(**{
            key: each.read(value[key], assets) for key, each in wanted.items()
            if key not in lacking
        })  # fmt: skip


def _line(edit: Edit, wanted: dict[str, bytes]) -> dict[str, Any]:
    """The operation in plain values; its tensors are added to what is wanted, by file name."""
    values: dict[str, Any] = {"edit": edit.name}
    for name, kind in _kinds(type(edit)).items():
        values[name] = kind.write(getattr(edit, name), wanted)
    return values


def _kinds(operation: Any) -> dict[str, "Kind"]:
    """How each field of an operation is written and read, by its annotation."""
    hints = get_type_hints(operation, include_extras=True)
    return {field.name: KINDS[hints[field.name].__metadata__[0]] for field in fields(operation)}


@dataclass(frozen=True)
class Kind:
    """How a kind of field is written and read."""

    write: Callable[[Any, dict[str, bytes]], Any]
    """Plain value of a value; adds files to the dictionary."""
    read: Callable[[Any, Path], Any]
    """The value of a plain value, with the folder of the files; raises what is wrong with it."""


def _plain(read: Callable[[Any], Any], write: Callable[[Any], Any] = lambda value: value) -> Kind:
    return Kind(lambda value, wanted: write(value), lambda value, assets: read(value))


def _ids(value: Any) -> tuple[int, ...]:
    ids = tuple(whole_number(each, 1) for each in value)
    if not isinstance(value, list) or not ids or len(set(ids)) < len(ids):
        raise ValueError(f"{value} is no list of different ids")
    return ids


def _motion(value: Any) -> Similarity:
    w, x, y, z = (number(each) for each in value["quat_wxyz"])
    if abs(w * w + x * x + y * y + z * z - 1) > 1e-6:
        raise ValueError(f"{value['quat_wxyz']} is no quaternion of unit length")
    # A turn or scaling about a far point is a long translation: carried() checks what comes out.
    x_by, y_by, z_by = (number(each) for each in value["translation"])
    return Similarity((x_by, y_by, z_by), (w, x, y, z), factor(number(value["scale"]), "scale"))


def _share(value: Any) -> float:
    if not 0 <= number(value) <= 1:
        raise ValueError(f"{value} is no number in [0, 1]")
    return number(value)


def _put(tensors: Mapping[str, Tensor], wanted: dict[str, bytes]) -> str:
    data = safetensors_bytes(tensors)
    name = f"{hashlib.sha256(data).hexdigest()}.safetensors"
    wanted[name] = data
    return name


def _get(
    value: Any, assets: Path, names: set[str], *, more: str | None = None
) -> dict[str, Tensor]:
    """The tensors of a file: those of these names, and any whose names begin with `more`."""
    name = text(value)
    digest = name.removesuffix(".safetensors")
    if len(digest) != 64 or set(digest) - set("0123456789abcdef") or name == digest:
        raise ValueError(f"{name[:80]!r} is no name of a file of an edit")
    file = assets / name
    if not file.is_file():
        raise FileNotFoundError(f"the scene is incomplete: {file} is missing")
    data = file.read_bytes()
    if hashlib.sha256(data).hexdigest() != digest:
        raise ValueError(f"{file.name} is not the file that the edit was written for")
    tensors = load_tensors(data)
    found = {name for name in tensors if more is None or not name.startswith(more)}
    if found != names:
        raise ValueError(f"{file.name} holds {sorted(tensors)}, wanted {sorted(names)}")
    return tensors


def _write_rows(value: Tensor, wanted: dict[str, bytes]) -> str | None:
    return _put({"rows": value}, wanted) if len(value) else None


def _read_rows(value: Any, assets: Path) -> Tensor:
    if value is None:
        return torch.zeros(0, dtype=torch.long)
    rows = _get(value, assets, {"rows"})["rows"]
    if rows.dtype != torch.int64 or rows.ndim != 1 or not len(rows) or int(rows.min()) < 0:
        raise ValueError(f"{rows.dtype} {tuple(rows.shape)} are no rows")
    return rows


def _write_masks(
    value: tuple[RunLengths, ...] | None, wanted: dict[str, bytes]
) -> list[dict[str, Any]] | None:
    return None if value is None else [mask.to_json() for mask in value]


def _read_masks(value: Any, assets: Path) -> tuple[RunLengths, ...] | None:
    """Masks of views; logs of version 1 name a file of them."""
    if value is None:
        return None
    if isinstance(value, list):
        return tuple(RunLengths.from_json(each) for each in value)
    masks = _get(value, assets, {"masks"})["masks"]
    if masks.dtype != torch.bool or masks.ndim != 3:
        raise ValueError(f"{masks.dtype} {tuple(masks.shape)} are no masks of views")
    return tuple(map(RunLengths.of, masks))


def _write_gaussians(value: Gaussians | None, wanted: dict[str, bytes]) -> str | None:
    return None if value is None or not len(value.means) else _put(vars(value), wanted)


def _read_gaussians(value: Any, assets: Path) -> Gaussians | None:
    if value is None:
        return None
    return _gaussians(_get(value, assets, {field.name for field in fields(Gaussians)}))


def _gaussians(tensors: Mapping[str, Tensor]) -> Gaussians:
    """The Gaussians among the tensors of a file, at least one, checked."""
    gaussians = Gaussians(**{field.name: tensors[field.name] for field in fields(Gaussians)})
    n, sh = len(gaussians.means), gaussians.sh
    shapes = {
        "means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,),
        "sh": (n, sh.shape[min(1, sh.ndim - 1)], 3), "anchor_index": (n,),
    }  # fmt: skip
    _check_tensors(vars(gaussians), shapes)
    check_gaussians(gaussians, "the part")
    if not n:
        raise ValueError("there are no Gaussians in it")
    return gaussians


def _check_tensors(tensors: Mapping[str, Tensor], shapes: Mapping[str, tuple[int, ...]]) -> None:
    for name, shape in shapes.items():
        kind = torch.int64 if name == "anchor_index" else torch.float32
        if tensors[name].dtype != kind or tuple(tensors[name].shape) != shape:
            found = f"{tensors[name].dtype} {tuple(tensors[name].shape)}"
            raise ValueError(f"{name} is {found}, wanted {kind} {shape}")


def _write_part(value: Part, wanted: dict[str, bytes]) -> str:
    own = {"positions": value.positions, "anchors": value.anchors, "group": value.group}
    return _put({**vars(value.gaussians), **own, **packed(value.semantics)}, wanted)


def _read_part(value: Any, assets: Path) -> Part:
    names = {field.name for field in fields(Gaussians)}
    own = {*names, "positions", "anchors", "group"}
    tensors = _get(value, assets, own, more=PACKED)
    k, c = len(tensors["positions"]), tensors["group"].shape[-1]
    _check_tensors(tensors, {"positions": (k, 3), "anchors": (k, c), "group": (c,)})
    gaussians = _gaussians(tensors)
    positions, anchors, group = (tensors[name] for name in ("positions", "anchors", "group"))
    if not all(each.isfinite().all() for each in (positions, anchors, group)):
        raise ValueError("the tokens of a part must be finite")
    if int(gaussians.anchor_index.max()) >= k:
        raise ValueError(f"anchor_index beyond {k}")
    packs = {name: each for name, each in tensors.items() if name not in own}
    semantics = unpacked(packs, groups=1, anchors=k)
    return Part(gaussians, positions, anchors, group, semantics)


KINDS: dict[str, Kind] = {
    "id": _plain(lambda value: whole_number(value, 1)),
    "ids": _plain(_ids, list),
    "motion": _plain(_motion, lambda value: {
        "translation": list(value.translation), "quat_wxyz": list(value.quat_wxyz),
        "scale": value.scale,
    }),
    "color": _plain(lambda value: color([number(each) for each in value]), list),
    "direction": _plain(lambda value: given_up([number(each) for each in value]).up, list),
    "text": _plain(text),
    "label": _plain(lambda value: None if value is None else check_label(text(value))),
    "share": _plain(_share),
    "share or null": _plain(lambda value: None if value is None else _share(value)),
    "source": _plain(lambda value: None if value is None else check_label_source(text(value))),
    "rows": Kind(_write_rows, _read_rows),
    "masks": Kind(_write_masks, _read_masks),
    "gaussians": Kind(_write_gaussians, _read_gaussians),
    "part": Kind(_write_part, _read_part),
}  # fmt: skip
"""By the kinds of the operations' fields."""
