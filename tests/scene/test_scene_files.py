import errno
import json
import shutil
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image
from safetensors.torch import load_file, save_file

import instok3d
from instok3d.files import sha256_of
from instok3d.scene import files
from instok3d.scene.previews import save_with_previews
from instok3d.scene.record import SceneRecord
from instok3d.scene.scene import Scene
from instok3d.scene.versions import VERSION
from kill_points import every_kill
from made_scene import made_empty_scene, made_scene, made_tokens


def assert_same(first: Scene, second: Scene) -> None:
    for name in (field.name for field in fields(SceneRecord)):
        value, other = getattr(first, name), getattr(second, name)
        if isinstance(value, torch.Tensor):
            assert torch.equal(value, other), name
        elif name == "semantics":
            assert list(value) == list(other)
            for encoder, one in value.items():
                for part, tensor in vars(one).items():
                    assert torch.equal(tensor, getattr(other[encoder], part)), f"{encoder}.{part}"
        elif hasattr(value, "__dataclass_fields__") and name not in ("provenance", "vertical"):
            for part, tensor in vars(value).items():
                assert torch.equal(tensor, getattr(other, part)), f"{name}.{part}"
        else:
            assert value == other, name


def contents(folder: Path) -> dict[str, bytes]:
    found = [file for file in sorted(folder.rglob("*")) if file.is_file()]
    return {str(file.relative_to(folder)): file.read_bytes() for file in found}


@pytest.mark.parametrize("make", [lambda: made_scene(made_tokens()), made_empty_scene])
def test_what_was_saved_is_loaded(tmp_path: Path, make: Callable[[], Scene]):
    scene = make()
    scene.save(tmp_path / "room.itk")
    assert_same(instok3d.load(tmp_path / "room.itk"), scene)


def test_a_scene_folder_holds_what_it_promises(tmp_path: Path, scene: Scene):
    scene.save(tmp_path / "room.itk")
    assert sorted(contents(tmp_path / "room.itk")) == [
        "cameras.json", "gaussians.safetensors", "inputs/000.png", "inputs/001.png",
        "objects.json", "scene.json", "semantics/made-3.safetensors", "tokens.safetensors",
    ]  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["room.itk"]
    header = json.loads((tmp_path / "room.itk/scene.json").read_text())
    assert header["version"] == VERSION
    assert header["inputs"] == {view.file: view.sha256 for view in scene.views}
    camera = json.loads((tmp_path / "room.itk/cameras.json").read_text())[1]
    # The second camera stands 0.1 to the right of the first, which is the world.
    assert [row[3] for row in camera["world_from_cam"]] == pytest.approx([0.1, 0, 0, 1])
    # A photo of 48 x 66 was scaled by 1/2 and 0.5 px cropped on each side: f doubles.
    assert camera["photo_intrinsics"][0] == pytest.approx([2 * 32 / 1.2, 0, 33])


def test_the_same_scene_gives_the_same_bytes_also_after_loading(tmp_path: Path, scene: Scene):
    scene.save(tmp_path / "a.itk")
    made_scene(made_tokens()).save(tmp_path / "b.itk")
    instok3d.load(tmp_path / "a.itk").save(tmp_path / "c.itk")
    first = contents(tmp_path / "a.itk")
    assert contents(tmp_path / "b.itk") == first
    assert contents(tmp_path / "c.itk") == first


def test_previews_stand_beside_the_scene_and_show_its_objects(tmp_path: Path, scene: Scene):
    stages: list[str] = []
    save_with_previews(scene, tmp_path / "room.itk", progress=stages.append)
    objects = [f"previews: object {number} of 2" for number in (1, 2)]
    assert stages == [*objects, "previews: contact sheet", "save"]
    pictures = sorted(contents(tmp_path / "room.itk" / "previews"))
    assert pictures == ["contact_sheet.png", "objects/001.png", "objects/003.png"]
    assert_same(instok3d.load(tmp_path / "room.itk"), scene)
    with Image.open(tmp_path / "room.itk/previews/objects/001.png") as tile:
        assert tile.size == (scene.width, scene.height)
        assert tile.getpixel((scene.width - 1, 0)) == (255, 255, 255)
        red, green, blue = tile.getpixel((8, 11))  # pyright: ignore[reportGeneralTypeIssues]
        assert red > 150 > max(green, blue)


def test_nothing_is_overwritten_unasked(tmp_path: Path, scene: Scene, empty_scene: Scene):
    path = tmp_path / "room.itk"
    scene.save(path)
    before = contents(path)
    with pytest.raises(FileExistsError, match="pass --overwrite"):
        empty_scene.save(path)
    assert contents(path) == before
    empty_scene.save(path, overwrite=True)
    assert_same(instok3d.load(path), empty_scene)
    assert [each.name for each in tmp_path.iterdir()] == ["room.itk"]


def test_only_a_scene_is_ever_replaced(tmp_path: Path, scene: Scene):
    folder = tmp_path / "home"
    folder.mkdir()
    (folder / "diary.txt").write_text("mine")
    file = tmp_path / "file.itk"
    file.write_text("mine")
    link = tmp_path / "link.itk"
    link.symlink_to(folder)
    for path in (folder, file, link):
        with pytest.raises(FileExistsError, match="is not a scene folder and will not be replaced"):
            scene.save(path, overwrite=True)
    assert (folder / "diary.txt").read_text() == file.read_text() == "mine"


def test_a_missing_parent_folder_is_named(tmp_path: Path, scene: Scene):
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*/nowhere"):
        scene.save(tmp_path / "nowhere" / "room.itk")


@pytest.mark.parametrize("kind", [OSError, KeyboardInterrupt])
@pytest.mark.parametrize("step", ["write_safetensors", "_write_json"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_an_interrupted_save_leaves_what_was_there(
    tmp_path: Path,
    scene: Scene,
    empty_scene: Scene,
    monkeypatch: pytest.MonkeyPatch,
    kind: type[BaseException],
    step: str,
    overwrite: bool,
):
    path = tmp_path / "room.itk"
    if overwrite:
        empty_scene.save(path)
    before = contents(tmp_path)
    calls = []
    error = kind(errno.ENOSPC, "No space left on device")

    def fail_the_second_time(*arguments: object) -> bytes:
        calls.append(arguments)
        if len(calls) == 2:
            raise error
        return b""

    monkeypatch.setattr(files, step, fail_the_second_time)
    with pytest.raises(kind):
        scene.save(path, overwrite=overwrite)
    assert kind is KeyboardInterrupt or getattr(error, "filename", None) == str(path)
    assert contents(tmp_path) == before
    assert [each.name for each in tmp_path.iterdir()] == (["room.itk"] if overwrite else [])


def test_the_old_scene_comes_back_when_the_last_step_fails(
    tmp_path: Path, scene: Scene, empty_scene: Scene, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "room.itk"
    empty_scene.save(path)
    before = contents(tmp_path)

    def failing(*paths: Path) -> bool:
        raise OSError(errno.EIO, "I/O error")

    monkeypatch.setattr("instok3d.files.exchange", failing)
    with pytest.raises(OSError, match="I/O error"):
        scene.save(path, overwrite=True)
    assert contents(tmp_path) == before


def test_killed_at_any_operation_it_leaves_the_old_or_the_new_scene(
    tmp_path: Path, scene: Scene, empty_scene: Scene
):
    def prepare() -> Path:
        shutil.rmtree(tmp_path / "work", ignore_errors=True)
        shutil.copytree(tmp_path / "before", tmp_path / "work")
        return tmp_path / "work"

    def replace_scene(folder: Path) -> None:
        scene.save(folder / "room.itk", overwrite=True)

    (tmp_path / "before").mkdir()
    empty_scene.save(tmp_path / "before" / "room.itk")
    found = set()
    for folder in every_kill(prepare, replace_scene, step=5):
        found.add(len(instok3d.load(folder / "room.itk").objects))
        replace_scene(folder)
        assert [path.name for path in folder.iterdir()] == ["room.itk"]
    assert found == {0, 2}


def test_of_two_who_write_one_scene_the_second_is_refused_at_its_end(
    tmp_path: Path, scene: Scene, empty_scene: Scene
):
    path = tmp_path / "room.itk"
    with pytest.raises(FileExistsError, match=r"room\.itk has come to be there meanwhile"):
        files.save_record(empty_scene, path, more=lambda part: scene.save(path))
    assert_same(instok3d.load(path), scene)
    assert list(tmp_path.iterdir()) == [path]


def damage_json(name: str, change: Callable[[dict | list], None]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        value = json.loads((folder / name).read_text())
        change(value)
        (folder / name).write_text(json.dumps(value))

    return apply


def flip_a_byte(folder: Path) -> None:
    content = bytearray((folder / "gaussians.safetensors").read_bytes())
    content[-5] ^= 0x40
    (folder / "gaussians.safetensors").write_bytes(bytes(content))


def damage_object(change: Callable[[Any], object]) -> Callable[[Path], None]:
    """The first entry of objects.json changed."""
    return damage_json("objects.json", lambda v: change(v["objects"][0]))


DAMAGE: dict[str, Callable[[Path], object]] = {
    r"gaussians\.safetensors is damaged": flip_a_byte,
    r"tokens\.safetensors is damaged": lambda f: (f / "tokens.safetensors").write_bytes(
        b"\xff" * 64
    ),
    r"objects\.json is damaged": lambda f: (f / "objects.json").write_text("[{"),
    r"objects\.json is damaged.*UTF|codec": lambda f: (f / "objects.json").write_bytes(b"\xff\xfe"),
    r"scene\.json: .*1 to 4, not 9": damage_json("scene.json", lambda v: v.update(version=9)),
    r"scene\.json is damaged .it lacks 'units'": damage_json(
        "scene.json", lambda v: v.pop("units")
    ),
    r"'miles' is none of": damage_json("scene.json", lambda v: v.update(units="miles")),
    r"bad picture size": damage_json("scene.json", lambda v: v.update(height=10**9)),
    r"wanted a list of 1 to": damage_json("cameras.json", lambda v: v.clear()),
    r"view 0 .* size is not that of scene": damage_json("scene.json", lambda v: v.update(width=31)),
    r"000\.png: size": lambda f: Image.new("RGB", (31, 24)).save(f / "inputs/000.png"),
    r"intrinsics that are not 3 x 3 numbers": damage_json(
        "cameras.json", lambda v: v[0].update(intrinsics=[[1]])
    ),
    r"not 4 x 4": damage_json(
        "cameras.json", lambda v: [c.update(cam_from_world=[[1.0]]) for c in v]
    ),
    r"cannot be": damage_object(lambda v: v.update(gaussian_range=[0, 999])),
    r"not distinct": damage_object(lambda v: v.update(id=3)),
    r"wanted 3 finite": damage_object(lambda v: v.update(centroid=[1, 2])),
    r"names a view": damage_object(lambda v: v["seen"][0].update(view=7)),
    r"is damaged .a value in it is of another kind": damage_json(
        "objects.json", lambda v: v["objects"].append(3)
    ),
    r"001\.png is damaged": lambda f: (f / "inputs/001.png").write_bytes(b"\x89PNG"),
}


def put_row(name: str, row: int, value: object) -> Callable[[Path], None]:
    """A row of a tensor changed, with its file's hash in scene.json."""
    part = "tokens" if name == "assignment" else "gaussians"

    def apply(folder: Path) -> None:
        file = folder / f"{part}.safetensors"
        tensors = load_file(file)
        tensors[name][row] = torch.as_tensor(value)
        save_file(tensors, file)
        damage_json("scene.json", lambda v: v["sha256"].update({file.name: sha256_of(file)}))(
            folder
        )

    return apply


def change_camera(key: str, row: int, column: int, number: float) -> Callable[[Path], None]:
    return damage_json("cameras.json", lambda v: v[1][key][row].__setitem__(column, number))


DAMAGE |= {
    "has 1 values in scales that are no lengths above 0": put_row("scales", 3, [1.0, 0.0, 1.0]),
    "values in scales": put_row("scales", 3, [1.0, -1.0, 1.0]),
    r"values in opacities that are no numbers in \[0, 1\]": put_row("opacities", 3, 1.5),
    "values in opacities": put_row("opacities", 3, torch.nan),
    "values in quats that are no quaternions of unit": put_row("quats", 3, [0.0] * 4),
    "values in means that are no finite numbers": put_row("means", 3, torch.nan),
    "values in means": put_row("means", 3, 1e30),
    "values in sh that are no finite": put_row("sh", 3, torch.inf),
    "values in anchor_index that are no row": put_row("anchor_index", 3, -1),
    "anchor_index beyond 10": put_row("anchor_index", 3, 10),
    "assignment holds rows that are no probabilities": put_row("assignment", 3, 0.1),
    "assignment holds numbers that are not finite": put_row("assignment", 3, torch.nan),
    r"view 1 has a pose whose rotation is not orthonormal": change_camera(
        "cam_from_world", 0, 0, 2.0
    ),
    "view 1 has a pose whose last row is": change_camera("cam_from_world", 3, 0, 0.1),
    "view 1 stands 1e.30 units from the origin": change_camera("cam_from_world", 0, 3, 1e30),
    "view 1 has the focal length -2": change_camera("intrinsics", 0, 0, -2.0),
    "view 1 has intrinsics with 3 below the diagonal": change_camera("intrinsics", 1, 0, 3.0),
    "the number NaN is not finite": change_camera("intrinsics", 0, 2, torch.nan),
    "num_gaussians of 'object#1' is not that": damage_object(
        lambda v: v.update(num_gaussians=3)
    ),
    r"'red' is no colour": damage_object(lambda v: v.update(color="red")),
    r"7 is no number in \[0, 1\]": damage_object(lambda v: v.update(confidence=7)),
    "is inside out": damage_object(lambda v: v["aabb"]["min"].__setitem__(0, 9)),
    r"the box has the size \(-1": damage_object(
        lambda v: v["obb"]["size"].__setitem__(0, -1)
    ),
    "the quaternion .* is not of unit": damage_object(
        lambda v: v["obb"].update(quat_wxyz=[0, 0, 0, 0])
    ),
    "the bbox of 'object#1' is not within": damage_object(
        lambda v: v["best_view"].update(box=[0, 0, 33, 2])
    ),
    "are no mask of 24 x 32": damage_object(
        lambda v: v["seen"][0]["mask"].update(counts=[3, 4])
    ),
    "a mask of 'object#1' is not of 24 x 32": damage_object(lambda v: v["seen"][0].update(
            mask={"size": [1, 9], "counts": [4, 5]}, pixels=5
        ),
    ),
    "is said to have 9999": damage_object(
        lambda v: v["seen"][0].update(pixels=9999)
    ),
    "reads objects of version 4, not 5": damage_json("objects.json", lambda v: v.update(version=5)),
    "holds no list of objects": damage_json("objects.json", lambda v: v.update(objects={})),
    "two objects have one key": damage_object(lambda v: v.update(key="object#3")),
    "True is no whole number": damage_object(lambda v: v.update(num_anchors=True)),
    "its pixel_map is not to pictures": damage_json(
        "cameras.json", lambda v: v[0]["pixel_map"].update(width=31)
    ),
    "wanted 0 < near < far": damage_json(
        "scene.json", lambda v: v.update(near_far=[1, 1])
    ),
}  # fmt: skip


@pytest.mark.parametrize("message", DAMAGE)
def test_a_damaged_scene_is_refused_with_the_reason(tmp_path: Path, scene: Scene, message: str):
    scene.save(tmp_path / "room.itk")
    DAMAGE[message](tmp_path / "room.itk")
    with pytest.raises(ValueError, match=message):
        instok3d.load(tmp_path / "room.itk")


def test_a_scene_that_could_not_be_read_again_is_not_written(tmp_path: Path, scene: Scene):
    flat = replace(scene.gaussians, scales=torch.zeros_like(scene.gaussians.scales))
    with pytest.raises(ValueError, match="the scene has 120 values in scales"):
        replace(scene, gaussians=flat).save(tmp_path / "room.itk")
    assert not list(tmp_path.iterdir())


def test_missing_files_are_named(tmp_path: Path, scene: Scene):
    with pytest.raises(FileNotFoundError, match="no folder of this name"):
        instok3d.load(tmp_path / "room.itk")
    for name in ("tokens.safetensors", "objects.json", "inputs/000.png", "scene.json"):
        scene.save(tmp_path / "room.itk")
        (tmp_path / "room.itk" / name).unlink()
        with pytest.raises(FileNotFoundError, match=name):
            instok3d.load(tmp_path / "room.itk")
        shutil.rmtree(tmp_path / "room.itk")


@pytest.mark.parametrize(
    "name", ["caf\xe9 \u5c45 \U0001f600.jpg", "\udcff.jpg", 245 * "n" + ".jpg"]
)
def test_photos_of_any_name_are_kept(tmp_path: Path, scene: Scene, name: str):
    views = tuple(replace(view, file=f"{index}{name}") for index, view in enumerate(scene.views))
    named = replace(scene, views=views, warnings=(f"{name} is dark",))
    named.save(tmp_path / "room.itk")
    assert_same(instok3d.load(tmp_path / "room.itk"), named)
    (tmp_path / "room.itk/scene.json").read_text(encoding="utf-8")
