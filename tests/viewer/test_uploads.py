"""Files from a browser: what is taken, and what whoever has the token cannot do with them."""

import io
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from PIL import Image

from instok3d.formats.registry import ExportOptions, export_scene
from instok3d.scene.scene import Scene
from instok3d.viewer.serving import serve, stop_serving
from instok3d.viewer.session import MOST, Session
from instok3d.viewer.uploads import UploadGate, shown_name, uploaded_scene
from made_scene import made_empty_scene, made_scene, made_tokens
from splat_scenes import furnished_scene

LIMIT = 2**20


def exported(tmp_path: Path, name: str, *, with_ids: bool) -> bytes:
    export_scene(furnished_scene(60), tmp_path / name, ExportOptions(with_ids=with_ids))
    return (tmp_path / name).read_bytes()


def zipped(scene: Scene, tmp_path: Path, above: str = "room.itk/") -> bytes:
    scene.save(tmp_path / "room.itk")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted((tmp_path / "room.itk").rglob("*")):
            archive.write(file, above + str(file.relative_to(tmp_path / "room.itk")))
    return stream.getvalue()


def archive(*members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as made:
        for name, content in members:
            made.writestr(name, content)
    return stream.getvalue()


def test_a_file_of_gaussians_is_a_scene_with_its_objects(tmp_path: Path):
    scene = uploaded_scene("a.ply", exported(tmp_path, "a.ply", with_ids=True), LIMIT)
    assert [item.id for item in scene.objects] == [2]
    assert scene.objects[0].num_gaussians == furnished_scene(60).object(2).num_gaussians
    assert scene.provenance.model == "imported from a.ply"
    torch.testing.assert_close(scene.gaussians.means, furnished_scene(60).gaussians.means)


def test_where_no_objects_are_named_all_of_it_is_one(tmp_path: Path):
    data = exported(tmp_path, "a.splat", with_ids=False)
    scene = uploaded_scene("C:\\scans\\A.SPLAT", data, LIMIT)
    assert [item.num_gaussians for item in scene.objects] == [60]
    assert scene.provenance.model == "imported from A.SPLAT"


@pytest.mark.parametrize("above", ["", "room.itk/", "deep/room.itk/"])
def test_a_zipped_scene_folder_is_that_scene_with_its_edits(tmp_path: Path, above: str):
    edited = made_scene(made_tokens()).rename(1, "chair")
    scene = uploaded_scene("room.zip", zipped(edited, tmp_path, above), LIMIT)
    assert [item.key for item in scene.objects] == [item.key for item in edited.objects]
    assert scene.edits == edited.edits
    assert torch.equal(scene.gaussians.means, edited.gaussians.means)
    assert torch.equal(scene.photos, edited.photos)


@pytest.mark.parametrize(
    ("given", "shown"),
    [("a.ply", "a.ply"), ("../../etc/passwd", "passwd"), ("C:\\x\\b.spz", "b.spz"), ("", "file"),
     ("a\n\x1b[2Jb.ply", "a??[2Jb.ply"), ("/", "file"), ("x" * 500 + ".ply", "x" * 56 + ".ply")],
)  # fmt: skip
def test_a_name_is_its_last_part_printable_and_short(given: str, shown: str):
    assert shown_name(given) == shown


def flat_picture(side: int) -> bytes:
    """A square PNG of one colour: about 3 * side * side / 1000 bytes."""
    stream = io.BytesIO()
    Image.new("RGB", (side, side)).save(stream, "PNG")
    return stream.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", b"", "a.ply"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n", "a.ply"),
        ("../a.ply", b"nonsense", "a.ply"),
        ("a.html", b"<html>", r"cannot read a.html: its name must end in \.ply"),
        (".ply/../x", b"", "cannot read x"),
        ("a.zip", b"PK", "a.zip is damaged"),
        ("a.zip", archive(), "there is no scene.json in it"),
        ("a.zip", archive(("scene.json", b"{}")), r"a\.zip: scene"),
        ("a.zip", archive(("scene.json", b"{}"), ("../out", b"x")), r"named '\.\./out'"),
        ("a.zip", archive(("/scene.json", b"{}")), "named '/scene.json'"),
        ("a.zip", archive(("a\\..\\scene.json", b"{}")), "a file in it is named"),
        ("a.zip", archive(("scene.json", bytes(LIMIT + 1))), "unpacked it has 1,048,577 bytes"),
        ("a.zip", archive(("scene.json", b"{}"), method=zipfile.ZIP_BZIP2), "another method"),
        ("a.zip", archive(*((f"{n}", b"") for n in range(4097))), "it has 4097 files"),
        ("a.zip", archive(("scene.json", b"{}"), ("inputs/000.png", flat_picture(500)),
                          ("previews/inputs/000.png", flat_picture(316))),
         "its photos have 1,049,568 bytes of pixels; at most 1,048,576"),
        ("a.zip", archive(("scene.json", b"{}"), ("inputs/000.png", b"PNG")), "a.zip: scene"),
    ],
)  # fmt: skip
def test_what_is_no_scene_is_refused_by_the_name_it_was_sent_with(
    tmp_path: Path, name: str, content: bytes, message: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(ValueError, match=message) as found:
        uploaded_scene(name, content, LIMIT)
    assert str(tmp_path) not in str(found.value)
    assert "\n" not in str(found.value)
    assert list(tmp_path.iterdir()) == []


def test_a_member_that_is_longer_than_it_says_is_cut_off(tmp_path: Path):
    """The sizes of an archive are what its maker wrote: no more is unpacked than they promise."""
    data = archive(("scene.json", bytes(100_000)))
    lie = data.replace((100_000).to_bytes(4, "little"), (10).to_bytes(4, "little"))
    assert lie != data
    with pytest.raises(ValueError, match=r"^a\.zip"):
        uploaded_scene("a.zip", lie, LIMIT)


def test_added_scenes_get_names_of_their_own_and_are_not_too_many():
    scene, empty = made_scene(made_tokens()), made_empty_scene()
    session = Session(scene, others={"a.ply": scene})
    assert session.add_other("a.ply", scene) == "a.ply (2)"
    assert session.add_other("a.ply", scene) == "a.ply (3)"
    with pytest.raises(ValueError, match=r"b\.ply has no objects"):
        session.add_other("b.ply", empty)
    for _ in range(MOST - 2):
        session.add_other("c.ply", scene)
    with pytest.raises(ValueError, match="8 files were added before"):
        session.add_other("c.ply", scene)
    assert len(session.others) == 1 + MOST


Send = Callable[..., None]


@pytest.fixture
def gate() -> Iterator[tuple[UploadGate, Any]]:
    """Before the panel of a real server, and a button that takes files."""
    pytest.importorskip("viser", reason="needs viser: '.[view]'")
    server, _ = serve(port=0, title="test", hover=lambda x, y: "", upload_limit_bytes=100)
    yield UploadGate(server.gui, 100), server.gui.add_upload_button("Add")
    stop_serving(server)


def coming(gate: tuple[UploadGate, Any]) -> dict[str, int]:
    """Bytes that are kept of each file."""
    found = gate[0]._coming().items()
    return {name: sum(map(len, each["parts"].values())) for name, each in found}


def start(gate: tuple[UploadGate, Any], name: str, size: int, parts: int, client: int = 1) -> None:
    gate[0].start(client, SimpleNamespace(
        source_component_uuid=gate[1]._impl.uuid, transfer_uuid=name, filename="a.ply",
        mime_type="", part_count=parts, size_bytes=size,
    ))  # fmt: skip


def part(gate: tuple[UploadGate, Any], name: str, at: int, data: bytes, client: int = 1) -> None:
    gate[0].part(client, SimpleNamespace(
        source_component_uuid=gate[1]._impl.uuid, transfer_uuid=name, part_index=at, content=data
    ))  # fmt: skip


def test_no_more_is_kept_than_the_limit_of_all_files_together(gate: tuple[UploadGate, Any]):
    for size, parts in [(101, 1), (10**15, 1), (0, 0), (-1, 1), (100, 101), (100, 0), (5, -1)]:
        start(gate, "x", size, parts)
        assert coming(gate) == {}
    start(gate, "a", 60, 2)
    start(gate, "b", 41, 2)
    start(gate, "a", 1, 1)  # would begin anew what is coming
    part(gate, "b", 0, bytes(20))
    part(gate, "a", 0, bytes(30))
    part(gate, "a", 1, bytes(30), client=2)
    part(gate, "a", 7, bytes(30))
    assert coming(gate) == {"a": 30}
    part(gate, "a", 1, bytes(31))  # more than it was said to be
    assert coming(gate) == {}
    start(gate, "c", 100, 2)
    part(gate, "c", 0, b"")
    assert coming(gate) == {}


def test_a_file_that_came_whole_is_taken_from_the_button(gate: tuple[UploadGate, Any]):
    start(gate, "a", 5, 2)
    part(gate, "a", 1, b"45")
    part(gate, "a", 0, b"123")
    assert coming(gate) == {}
    assert (gate[1].value.name, gate[1].value.content) == ("a.ply", b"12345")


def test_without_a_limit_nobody_listens_for_files():
    pytest.importorskip("viser", reason="needs viser: '.[view]'")
    from viser import _messages

    server, _ = serve(port=0, title="test", hover=lambda x, y: "")
    handlers = server._websock_server._incoming_handlers
    assert _messages.FileTransferStartUpload not in handlers
    assert _messages.FileTransferPart not in handlers
    stop_serving(server)
