"""Which ScanNet scans are for training, validation and test, as Uni3R and LSM divide them."""

import re
import reprlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from instok3d.datasets.prepared import Split
from instok3d.reading import naming_damage, parse_json, text, whole_number

FIRST_VAL = "scene0640_01"
"""Of the 1,513 annotated scans in order of name, the last 150 begin here."""
LAST_ANNOTATED = "scene0706_00"
"""Later names are ScanNet's hidden test scans, which have no annotation."""
IGNORED = ("scene0696_02",)
"""Left out of the test scenes by the loaders of LSM, Uni3R and C3G."""
NUM_TEST = 40
TEST_LIST = "selected_seqs_test.json"
POSE_FRAMES = range(0, 300, 10)
"""Raw frames of a test scene whose poses must be finite."""
SCAN_NAME = re.compile(r"scene\d{4}_\d{2}")

_POOL = (
    "0686_01-02 0687_00 0688_00 0689_00 0690_00-01 0691_00-01 0692_00-04 0693_00-02 0694_00-01 "
    "0695_00-03 0696_00-02 0697_00-03 0698_00-01 0699_00 0700_00-02 0701_00-02 0702_00-02 "
    "0703_00-01 0704_00-01 0705_00-02 0706_00"
)


def _expanded(ranges: str) -> tuple[str, ...]:
    names = []
    for part in ranges.split():
        room, scans = part.split("_")
        first, _, last = scans.partition("-")
        names += [f"scene{room}_{k:02d}" for k in range(int(first), int(last or first) + 1)]
    return tuple(names)


TEST_POOL = _expanded(_POOL)
"""The last 50 annotated scans, from which LSM took its 40 test scenes."""


@dataclass(frozen=True)
class SceneList:
    """The test scenes, and where the list comes from."""

    names: tuple[str, ...]
    rule: str
    """One sentence, kept with the prepared scenes."""


def published_test_scenes(data: bytes, what: str) -> tuple[SceneList, dict[str, list[str]]]:
    """LSM's own list and the frame ids of each scene, from its selected_seqs_test.json.

    Args:
        data: The bytes of the file.
        what: Its name for messages.

    Raises:
        ValueError: The file is damaged.
    """
    remedy = "it must map scenes to frames"
    chosen = parse_json(data, what, remedy)
    with naming_damage(what, remedy):
        frames = {_scan_name(name): _frame_ids(name, ids) for name, ids in chosen.items()}
        names = tuple(name for name in sorted(frames) if name not in IGNORED)
        if not names:
            raise ValueError("it names no scene")
    return SceneList(names, f"the scenes of LSM's {TEST_LIST} without {IGNORED[0]}"), frames


def _scan_name(name: str) -> str:
    if not SCAN_NAME.fullmatch(name):
        raise ValueError(f"{reprlib.repr(name)} is no name of a scan")
    return name


def _frame_ids(name: str, ids: Any) -> list[str]:
    if not isinstance(ids, list):
        raise ValueError(f"the frames of {name} are no list")
    return [_frame_id(each) for each in ids]


def _frame_id(value: Any) -> str:
    return str(whole_number(value)) if isinstance(value, int) else text(value)


def fallback_test_scenes(has_finite_poses: Mapping[str, bool]) -> SceneList:
    """The first 40 of the last 50 scans, without those of non-finite poses and scene0696_02.

    For when LSM's list is not at hand; its exact 40 names are published nowhere else.

    Args:
        has_finite_poses: For each scan of TEST_POOL that could be read, whether all poses of
            POSE_FRAMES are finite. Others are taken to be sound.
    """
    sound = [name for name in TEST_POOL if has_finite_poses.get(name, True)]
    unread = sum(name not in has_finite_poses for name in TEST_POOL)
    lost = [name for name in TEST_POOL if not has_finite_poses.get(name, True)]
    names = tuple(name for name in sound if name not in IGNORED)[:NUM_TEST]
    rule = (
        f"the first {NUM_TEST} of the last 50 annotated scans without {', '.join(IGNORED)} and "
        f"{len(lost)} scans with non-finite poses ({', '.join(lost) or 'none'})"
    )
    if unread:
        rule += f"; {unread} of the 50 could not be checked"
    return SceneList(names, rule)


def split_of(name: str, test: Iterable[str]) -> Split | None:
    """The split of a scan; None for names that are not of the annotated scans.

    Training has all but the last 150 of the annotated scans in order of name; validation the last
    150 without the test scenes, which lie among them.
    """
    if not SCAN_NAME.fullmatch(name) or name > LAST_ANNOTATED:
        return None
    if name in test:
        return "test"
    return "val" if name >= FIRST_VAL else "train"
