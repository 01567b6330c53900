"""Models on the hub: what `--model hub:USER/NAME` stands for, and the push of one."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from instok3d.errors import MissingWeightsError
from instok3d.hub.cards import bash, card_text, table
from instok3d.hub.fetching import fetch
from instok3d.hub.manifest import MODEL, SEMANTICS, Manifest, manifest_of
from instok3d.hub.pushing import Pushed, check_push_target, push
from instok3d.hub.references import HubReference, is_hub, parse_reference
from instok3d.model.files import load_model, read_card
from instok3d.semantics.files import load_semantics
from instok3d.semantics.teachers.file import holds_encoder


@dataclass(frozen=True)
class ModelFile:
    """A model on this machine."""

    path: Path | None
    """None = the default model."""
    semantics: Path | None = None
    """What came with it from the hub, for `lifting.find_lifting`."""
    name: str = ""
    """hub:USER/NAME@COMMIT, for a model of the hub."""


def find_model(model: str | Path | None) -> ModelFile:
    """The file of a model, fetched from the hub where its name says so.

    Args:
        model: A file, which is not looked at; hub:USER/NAME or hub:USER/NAME@REVISION; or None.

    Raises:
        MissingWeightsError: It is not on this machine and the hub does not give it.
        ValueError: What came from the hub is not what was pushed.
    """
    if model is None or not is_hub(model):
        return ModelFile(None if model is None else Path(model))
    try:
        found = fetch(model, "model")
    except (OSError, ModuleNotFoundError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise MissingWeightsError(str(error)) from error
    semantics = found.folder / SEMANTICS if SEMANTICS in found.manifest.files else None
    return ModelFile(found.folder / MODEL, semantics, str(found.reference))


def push_model(
    file: Path,
    name: str,
    *,
    semantics: Path | None = None,
    licence: str = "",
    public: bool = False,
) -> Pushed:
    """Push a model to the hub with its card; see `instok3d.hub.pushing.push`.

    Args:
        file: A model file.
        name: hub:USER/NAME.
        semantics: The file of `instok3d train export` that names the objects of its scenes; it must
            hold its encoder.
        licence: Its identifier on the hub, such as apache-2.0; empty = none is stated.
        public: Whether a repository that is made is for everybody.

    Raises:
        FileNotFoundError, ValueError: A file is not there, damaged, or belongs to another model.
        ModuleNotFoundError, PermissionError, ConnectionError: As `push`.
    """
    reference = parse_reference(name)
    check_push_target(reference)
    model, files = load_model(file), {MODEL: file}
    if semantics is not None:
        load_semantics(semantics, model)
        if not holds_encoder(semantics):
            raise ValueError(
                f"{semantics} does not hold the encoder whose features it lifts, so nobody could "
                "use it alone: join them (runs/joined_weights.py), or push the model without"
            )
        files[SEMANTICS] = semantics
    manifest = manifest_of("model", files)
    card = model_card(read_card(file), manifest, reference, licence)
    return push(reference, manifest, files, card, public=public)


def model_card(
    said: dict[str, Any], manifest: Manifest, reference: HubReference, licence: str
) -> str:
    """The page of a model: use, training, figures of its validation, limits, hashes.

    Args:
        said: The card in the model's file.
        manifest: Of what is pushed.
        reference: Where to.
        licence: Its identifier, or empty.
    """
    metadata = {
        "license": licence or "other",
        "library_name": "instok3d",
        "pipeline_tag": "image-to-3d",
        "tags": ["gaussian-splatting", "3d-reconstruction", "instance-segmentation"],
    }
    trained = [(key, said[key]) for key in TRAINING if said.get(key) not in (None, "")]
    validation = said.get("validation") or {}
    figures = [(key, value) for key, value in validation.items() if key not in NO_FIGURES]
    parts = [
        "A model of InsTok3D: a few unposed photos of a room in, a 3D scene made of objects out.",
        bash(
            "pip install '.[models]'  # in a copy of the repository instok3d",
            f"instok3d reconstruct photos/ --model {reference} -o room.itk",
        ),
        "Objects get names by the semantics that come with it."
        if SEMANTICS in manifest.files
        else "No semantics come with it: objects have no names.",
        *_section("Training", ("what", ""), trained),
        *_section("Validation at its end", ("figure", ""), figures),
        *_lines("Notes", [str(said.get("notes") or "")]),
        *_lines("Credits", [str(line) for line in said.get("credits") or ()]),
        "## Licence",
        licence or "None is stated: ask whoever pushed it.",
    ]
    return card_text(metadata, str(said.get("name", reference.repository)), parts, manifest)


TRAINING = ("image_side", "unit", "steps", "hours", "scenes", "commit")
"""What a card says of its run that others can use; its settings are in the file."""
NO_FIGURES = ("kind", "elapsed_s")


def _section(title: str, head: tuple[str, str], rows: list[tuple[str, Any]]) -> list[str]:
    return [f"## {title}", table(head, rows)] if rows else []


def _lines(title: str, lines: list[str]) -> list[str]:
    kept = [f"- {' '.join(line.split())}" for line in lines if line.strip()]
    return [f"## {title}", "\n".join(kept)] if kept else []
