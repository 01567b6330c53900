from pathlib import Path

import pytest

from instok3d.formats.registry import (
    FORMATS,
    ExportOptions,
    export_scene,
    format_of,
    read_splats,
)
from instok3d.scene.scene import Scene


def test_every_function_of_the_table_is_there():
    for each in FORMATS:
        for name in (each.reader, each.writer):
            assert not name or callable(each._function(name)), (each.suffix, name)


def test_the_longest_ending_holds_in_either_case(tmp_path: Path):
    assert format_of(tmp_path / "A.PLY", to_write=True).suffix == ".ply"


def test_an_unknown_ending_is_refused_with_the_known_ones(tmp_path: Path, scene: Scene):
    with pytest.raises(ValueError, match=r"cannot write .*a\.obj: its name must end in .*\.ply"):
        export_scene(scene, tmp_path / "a.obj")
    (tmp_path / "a.obj").write_bytes(b"")
    with pytest.raises(ValueError, match=r"cannot read .*a\.obj: its name must end in .*\.ply"):
        read_splats(tmp_path / "a.obj")
    with pytest.raises(FileNotFoundError, match=r"there is no file .*b\.ply"):
        read_splats(tmp_path / "b.ply")


@pytest.mark.parametrize("each", [f for f in FORMATS if f.writer], ids=lambda f: f.suffix)
def test_a_file_that_is_there_is_kept_unless_told(tmp_path: Path, scene: Scene, each):
    file = tmp_path / f"a{each.suffix}"
    file.write_bytes(b"old")
    if each.suffix in (".usdz", ".sog"):
        pytest.importorskip("pxr" if each.suffix == ".usdz" else "gaussforge")
    with pytest.raises(FileExistsError):
        export_scene(scene, file)
    assert file.read_bytes() == b"old"
    assert [child.name for child in tmp_path.iterdir()] == [file.name]
    export_scene(scene, file, ExportOptions(overwrite=True))
    assert file.stat().st_size > 3
