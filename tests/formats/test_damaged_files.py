"""A damaged file of any format is read, or refused in one line."""

from pathlib import Path

import pytest

from instok3d.formats.registry import FORMATS, ExportOptions, FileFormat, export_scene, read_splats
from instok3d.types import check_gaussians
from mutations import of_bytes, survive
from packed_mutations import INSIDE
from splat_scenes import furnished_scene

BOTH = [each for each in FORMATS if each.reader and each.writer]


@pytest.mark.parametrize("each", BOTH, ids=lambda each: each.suffix)
def test_damage_is_survived(tmp_path: Path, each: FileFormat):
    file = tmp_path / f"a{each.suffix}"
    if each.suffix == ".sog":
        pytest.importorskip("gaussforge")
    export_scene(furnished_scene(60), file, ExportOptions(with_ids=True))

    def read() -> None:
        splats = read_splats(file)
        check_gaussians(splats.gaussians, file)
        assert len(splats.object_ids) == len(splats.gaussians.means)
        assert (splats.object_ids >= 0).all()

    read()
    assert survive(file, read, INSIDE.get(each.suffix, of_bytes), 60)
