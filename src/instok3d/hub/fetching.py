"""A model or a scene of the hub on this machine: at one commit, every file checked."""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from instok3d.files import sha256_of
from instok3d.hub.library import explained, hub_api, hub_library
from instok3d.hub.manifest import FILE, HubFile, Kind, Manifest, read_manifest
from instok3d.hub.references import HubReference, parse_reference

REPOSITORY_TYPES: dict[Kind, str] = {"model": "model", "scene": "dataset"}
"""How the hub calls the repositories."""


@dataclass(frozen=True)
class Fetched:
    """Files of the hub that are here and are what they should be."""

    reference: HubReference
    """At the commit."""
    folder: Path
    """In the cache of huggingface-hub; for reading alone."""
    manifest: Manifest


def fetch(name: str | Path, kind: Kind) -> Fetched:
    """What a name of the hub stands for, on this machine.

    Only files that the manifest names and that a model or a scene has are fetched, into the cache
    of huggingface-hub; a download that was cut goes on. A commit that is here needs no network. A
    branch, or no revision, becomes the commit that it is at today, which a warning names.

    Args:
        name: hub:USER/NAME, or hub:USER/NAME@REVISION.
        kind: What the repository holds.

    Raises:
        ModuleNotFoundError: huggingface-hub is not installed.
        FileNotFoundError: The hub has no such repository or revision, or no model or scene in it.
        PermissionError: The hub refuses.
        ConnectionError: The hub cannot be reached.
        ValueError: The name is none, or what came is not what the manifest says.
    """
    asked = parse_reference(name)
    api = hub_api()
    reference = asked.at(_commit(api, asked, kind))
    manifest_file = _download(api, reference, kind, FILE)
    manifest = read_manifest(manifest_file, kind, reference)
    folder = manifest_file.parent
    for file, wanted in manifest.files.items():
        _check(_download(api, reference, kind, file), wanted, f"{file} of {reference}")
    if not asked.pinned:
        warnings.warn(f"{asked} is {reference}: write this to get the same again", stacklevel=3)
    return Fetched(reference, folder, manifest)


def _commit(api: Any, reference: HubReference, kind: Kind) -> str:
    repository, revision = reference.repository, reference.revision
    with explained(reference, kind):
        if reference.pinned and isinstance(
            hub_library().try_to_load_from_cache(
                repository, FILE, revision=revision, repo_type=REPOSITORY_TYPES[kind]
            ),
            str,
        ):
            return str(revision)
        info = api.repo_info(repository, revision=revision, repo_type=REPOSITORY_TYPES[kind])
    return str(info.sha)


def _download(api: Any, reference: HubReference, kind: Kind, file: str) -> Path:
    with explained(reference, kind):
        place = api.hf_hub_download(
            reference.repository, file, revision=reference.revision,
            repo_type=REPOSITORY_TYPES[kind],
        )  # fmt: skip
    return Path(place)


def _check(path: Path, wanted: HubFile, what: str) -> None:
    """Fail if a file is not the one of the manifest; it is then fetched anew the next time."""
    size = path.stat().st_size
    found = sha256_of(path) if size == wanted.bytes else f"not looked at, for it has {size} bytes"
    if found != wanted.sha256:
        path.resolve().unlink()  # in the cache a link leads to the file
        path.unlink(missing_ok=True)
        raise ValueError(
            f"{what} is not the file that was pushed: its SHA-256 is {found}, wanted "
            f"{wanted.sha256} and {wanted.bytes} bytes; it was thrown away, try again"
        )
