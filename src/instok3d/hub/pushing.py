"""Files into a repository of the hub: one commit with the manifest and a card, or none."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from instok3d.hub.cards import MARK
from instok3d.hub.fetching import REPOSITORY_TYPES
from instok3d.hub.library import explained, hub_api, hub_library
from instok3d.hub.manifest import FILE, Kind, Manifest, read_manifest
from instok3d.hub.references import HubReference

CARD = "README.md"
OF_THE_HUB = {".gitattributes", CARD}
"""Files that a new repository may have."""


@dataclass(frozen=True)
class Pushed:
    """What the hub has now."""

    reference: HubReference
    """At the commit."""
    private: bool
    kept_card: bool
    """Whether a card of somebody's own was there, and stayed."""


def check_push_target(reference: HubReference) -> None:
    """Fail for a name that cannot be pushed to.

    Raises:
        ValueError: It has a revision.
    """
    if reference.revision is not None:
        raise ValueError(
            f"{reference} has a revision, and a push makes a new one on the main branch: leave "
            f"@{reference.revision} out"
        )


def push(
    reference: HubReference,
    manifest: Manifest,
    files: Mapping[str, Path],
    card: str,
    *,
    public: bool = False,
) -> Pushed:
    """Make files the newest commit of a repository, which is made where there is none.

    Files of the last push that are not among them go; earlier commits keep them. A card that does
    not bear the mark of `cards.card_text` is somebody's own and stays.

    Args:
        reference: Without revision.
        manifest: Of the files.
        files: By their path in the repository.
        card: README.md.
        public: Whether a repository that is made is for everybody to see; one that is there stays
            what it is.

    Raises:
        ModuleNotFoundError: huggingface-hub is not installed.
        PermissionError: The hub refuses, as without a login.
        ConnectionError: The hub cannot be reached.
        ValueError: The repository is there and holds something else.
    """
    check_push_target(reference)
    api, kind = hub_api(), manifest.kind
    where: dict[str, Any] = {"repo_type": REPOSITORY_TYPES[kind]}
    with explained(reference, kind):
        api.create_repo(reference.repository, private=not public, exist_ok=True, **where)
        info = api.repo_info(reference.repository, **where)
    there = {file.rfilename for file in info.siblings or ()}
    old = _last_push(api, reference.at(info.sha), there, kind)
    own_card = CARD in there and MARK not in _read(api, reference.at(info.sha), CARD, where)
    hub = hub_library()
    operations = [hub.CommitOperationAdd(name, str(path)) for name, path in files.items()]
    operations.append(hub.CommitOperationAdd(FILE, manifest.to_json().encode()))
    if not own_card:
        operations.append(hub.CommitOperationAdd(CARD, card.encode()))
    gone = sorted((old & there) - set(files))
    operations += [hub.CommitOperationDelete(name) for name in gone]
    with explained(reference, kind):
        made = api.create_commit(
            reference.repository, operations, commit_message=f"Push a {kind} of instok3d",
            parent_commit=info.sha, **where,
        )  # fmt: skip
    return Pushed(reference.at(made.oid), bool(info.private), own_card)


def _last_push(api: Any, reference: HubReference, there: set[str], kind: Kind) -> set[str]:
    """The files that the last push made."""
    if FILE in there:
        with explained(reference, kind):
            path = api.hf_hub_download(
                reference.repository, FILE,
                revision=reference.revision, repo_type=REPOSITORY_TYPES[kind],
            )  # fmt: skip
        return set(read_manifest(Path(path), kind, reference).files)
    if foreign := sorted(there - OF_THE_HUB):
        raise ValueError(
            f"{reference} holds files that are no {kind} of instok3d ({', '.join(foreign[:3])}): "
            "push to another name"
        )
    return set()


def _read(api: Any, reference: HubReference, file: str, where: Mapping[str, Any]) -> str:
    with explained(reference, "card"):
        path = api.hf_hub_download(reference.repository, file, revision=reference.revision, **where)
    return Path(path).read_text(encoding="utf-8", errors="replace")
