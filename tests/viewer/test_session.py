import random
from pathlib import Path

import pytest
import torch

from edited_scenes import assert_bit_equal
from imported_scene import imported_scene
from instok3d.geometry.moving import Similarity, quat_about
from instok3d.scene.edits.folder import editing
from instok3d.scene.scene import Scene
from instok3d.viewer.folder import SceneFolder
from instok3d.viewer.session import Session, axis_and_angle
from made_encoder import made_encoder
from made_scene import HEIGHT, WIDTH, made_empty_scene, made_scene, made_tokens
from splat_scenes import furnished_scene


@pytest.fixture
def scene() -> Scene:
    return made_scene(made_tokens())


@pytest.fixture
def session(scene: Scene) -> Session:
    return Session(scene, others={"other.itk": made_scene(made_tokens())})


def click(session: Session, x: float, y: float, *, add: bool = False) -> int:
    cameras = session.scene.cameras
    pose, lens = cameras.cam_from_world[0], cameras.intrinsics[0]
    return session.click(pose, lens, HEIGHT, WIDTH, (float(x), float(y)), add=add).object


def ids(session: Session) -> list[int]:
    return [item.id for item in session.selected]


def test_a_click_selects_the_object_there_and_nothing_else(session: Session):
    # The red blob, object 1, is left of the middle, the blue one, object 3, right of it.
    assert click(session, 8, 12) == 1
    assert ids(session) == [1]
    assert click(session, 24, 12) == 3
    assert ids(session) == [3]
    assert click(session, 16, 12, add=True) == 0
    assert ids(session) == [3]
    assert click(session, 8, 12, add=True) == 1
    assert ids(session) == [1, 3]
    click(session, 8, 12, add=True)
    assert ids(session) == [3]
    click(session, 16, 12)
    assert ids(session) == []


def test_the_list_selects_by_any_name(session: Session):
    session.select("object#3")
    session.select(1, add=True)
    assert ids(session) == [1, 3]
    session.toggle(1)
    assert ids(session) == [3]
    session.toggle("object#1")
    with pytest.raises(KeyError, match="no object 7"):
        session.select(7)
    assert ids(session) == [1, 3]


def test_words_select_what_they_mean(scene: Scene):
    session = Session(scene.duplicate(1, (0.3, 0, 0)), encoder=made_encoder())
    said = session.search("all chairs")
    assert ids(session) == [1, 5]
    assert said.startswith("all objects like 'chair': object#")
    session.search("the lamp")
    assert ids(session) == [3]
    session.search("chair")
    assert ids(session) in ([1], [5])
    before = ids(session)
    with pytest.raises(KeyError, match="'table' is not present in this scene"):
        session.search("table")
    with pytest.raises(ValueError, match="the question is empty"):
        session.search(" ")
    assert ids(session) == before


def test_without_an_encoder_there_is_no_search(session: Session):
    assert not session.can_search
    with pytest.raises(ValueError, match="this scene has no semantics"):
        session.search("chair")


def test_what_goes_is_no_longer_selected_and_comes_back_by_undo(session: Session, scene: Scene):
    session.select(1, 3)
    assert not session.can_undo
    session.remove()
    assert session.scene.objects == ()
    assert ids(session) == []
    session.undo()
    assert_bit_equal(session.scene, scene)
    assert session.can_redo
    session.redo()
    assert not session.can_redo
    assert session.scene.objects == ()


def test_a_hole_is_filled_on_request_where_photos_show_it():
    scene = furnished_scene()
    session = Session(scene)
    session.select(1)
    session.remove(fill=True)
    assert_bit_equal(session.scene, scene.remove(1, claim=True, fill="plane"))
    bare = Session(imported_scene())
    bare.select(7)
    with pytest.raises(ValueError, match="fill"):
        bare.remove(fill=True)
    bare.remove()
    assert len(bare.scene.objects) == 2


def test_what_is_new_is_selected(session: Session):
    session.select(3)
    session.duplicate()
    (copy,) = session.selected
    assert copy.id == 5
    first, second = session.scene.object(3).aabb, copy.aabb
    # Beside it: along one axis the copy begins where the first ends.
    assert any(abs(begin - end) < 1e-4 for begin, end in zip(second.min, first.max, strict=True))


def test_hiding_and_showing_are_edits(session: Session):
    session.select(1)
    session.hide()
    assert session.scene.object(1).hidden
    assert ids(session) == [1]
    session.show()
    assert not session.scene.object(1).hidden
    assert len(session.scene.edits) == 2


def test_merging_keeps_the_largest(session: Session):
    session.select(3)
    with pytest.raises(ValueError, match="select 2 objects or more first"):
        session.merge()
    session.select(1, add=True)
    session.merge()
    assert [item.id for item in session.scene.objects] == [1]
    assert ids(session) == [1]


def test_a_name_is_checked_before_anything_changes(session: Session):
    session.select(1)
    with pytest.raises(ValueError, match="could be taken for an id"):
        session.rename("chair #2")
    session.rename("red ball")
    assert [item.key for item in session.selected] == ["red ball#1"]
    session.select(1, 3)
    with pytest.raises(ValueError, match="select one object alone: 2 are selected"):
        session.rename("both")


def test_a_motion_by_hand_is_the_edit_of_it(session: Session, scene: Scene):
    motion = Similarity.about(
        scene.object(1).centroid, quat_wxyz=quat_about((0.6, 0.0, 0.8), 1.1), by=(0.2, -0.1, 0.3)
    )
    session.move(1, motion)
    start, count = scene.object(1).gaussian_range
    own = slice(start, start + count)
    expected = motion.points(scene.gaussians.means[own])
    torch.testing.assert_close(session.scene.gaussians.means[own], expected)
    assert torch.equal(session.scene.gaussians.means[count:], scene.gaussians.means[count:])


def test_a_rotation_is_its_axis_and_angle():
    for turn_deg in (0.5, 90.0, 200.0, 359.0):
        axis, angle = axis_and_angle(quat_about((0.0, 0.6, -0.8), turn_deg * torch.pi / 180))
        assert angle == pytest.approx(turn_deg)
        assert axis == pytest.approx((0.0, 0.6, -0.8))
    assert axis_and_angle((1.0, 0.0, 0.0, 0.0))[1] == 0


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_inserted_object_stands_where_was_clicked(session: Session):
    with pytest.raises(ValueError, match="click in the picture where it is to stand"):
        session.insert("other.itk", 1)
    click(session, 24, 12)
    place = session.shown.place
    assert place is not None
    assert place.point is not None
    with pytest.raises(KeyError, match="no scene 'x' to insert from; there are: other"):
        session.insert("x", 1)
    session.insert("other.itk", 1, scale=0.5)
    (new,) = session.selected
    assert new.id == 5
    up = torch.tensor(session.scene.vertical.up)
    aside = torch.tensor(new.obb.center) - torch.tensor(place.point)
    assert float((aside - (aside @ up) * up).norm()) < 1e-3


def test_an_edit_that_cannot_be_done_changes_nothing(session: Session, scene: Scene):
    for wrong in (session.remove, session.hide, session.split, session.duplicate):
        with pytest.raises(ValueError, match="select an object first"):
            wrong()
    with pytest.raises(ValueError, match="nothing to undo"):
        session.undo()
    assert session.scene is scene


def test_random_clicks_and_edits_are_undone_to_the_first_byte(session: Session, scene: Scene):
    draw = random.Random(5)
    for _ in range(60):
        click(session, draw.uniform(0, WIDTH), draw.uniform(0, HEIGHT), add=draw.random() < 0.5)
        words = draw.choice(["hide", "show", "duplicate", "turn", "undo", "redo"])
        do = (lambda: session.turn(20)) if words == "turn" else getattr(session, words)
        try:
            do()
        except ValueError as error:
            assert any(w in str(error) for w in ("select", "nothing to"))  # noqa: PT017
    while session.can_undo:
        session.undo()
    assert_bit_equal(session.scene, scene)


def test_a_scene_without_objects_has_nothing_to_select():
    session = Session(made_empty_scene())
    assert click(session, 3, 3) == 0
    assert session.selected == ()
    session.color_instances(True)
    assert session.shown.instance_colors


@pytest.fixture
def folder(scene: Scene, tmp_path: Path) -> Path:
    scene.save(tmp_path / "room.itk")
    return tmp_path / "room.itk"


def test_each_edit_is_in_the_folder_at_once_and_the_source_stays(folder: Path):
    before = (folder / "gaussians.safetensors").read_bytes()
    opened = SceneFolder(folder)
    session = Session(opened.opened, folder=opened)
    session.select(1)
    session.remove()
    assert_bit_equal(Scene.load(folder), session.scene)
    session.undo()
    assert Scene.load(folder).edits == ()
    assert len(Scene.load(folder).history.undone) == 1  # pyright: ignore[reportOptionalMemberAccess]
    assert (folder / "gaussians.safetensors").read_bytes() == before


def test_an_edit_that_cannot_be_kept_is_not_done(folder: Path):
    opened = SceneFolder(folder)
    session = Session(opened.opened, folder=opened)
    session.select(1)
    with editing(folder), pytest.raises(ValueError, match="another run is editing"):
        session.remove()
    assert len(session.scene.objects) == 2
    other = SceneFolder(folder)
    other.keep(other.opened.hide(3))
    with pytest.raises(ValueError, match="another run has edited"):
        session.remove()
    assert [edit.split()[0] for edit in Scene.load(folder).edits] == ["hide"]


def test_a_copy_is_written_beside_the_folder_and_nowhere_else(folder: Path):
    opened = SceneFolder(folder)
    session = Session(opened.opened, folder=opened)
    session.select(1)
    session.hide()
    path = session.save_as("copy.itk")
    assert path.parent.samefile(folder.parent)
    assert_bit_equal(Scene.load(path), session.scene)
    wrong = ("../out.itk", "/tmp/out.itk", "a\\b.itk", ".itk", ".hidden.itk", "out", "", "a\n.itk",
             "x" * 200 + ".itk", "C:out.itk")  # fmt: skip
    for name in wrong:
        with pytest.raises(ValueError, match="give a name such as room2"):
            session.save_as(name)
    with pytest.raises(FileExistsError, match="already there: give another name"):
        session.save_as("room.itk")
    assert sorted(each.name for each in folder.parent.iterdir()) == ["copy.itk", "room.itk"]
    with pytest.raises(ValueError, match="came from no folder"):
        Session(session.scene).save_as("b.itk")


def test_previews_are_renewed_where_they_are_and_were_outdated(folder: Path):
    opened = SceneFolder(folder)
    opened.renew_previews(opened.opened)
    assert not (folder / "previews").exists()
    (folder / "previews").mkdir()
    opened.renew_previews(opened.opened)
    assert not list((folder / "previews").iterdir())
    edited = opened.opened.hide(1)
    opened.keep(edited)
    opened.renew_previews(edited)
    assert (folder / "previews" / "contact_sheet.png").is_file()


def test_an_object_is_merged_with_one_that_it_touches(session: Session, scene: Scene):
    assert session.touching() == {}
    with pytest.raises(ValueError, match="select an object first"):
        session.merge_with(3)
    session.select(1)
    assert session.touching() == {}
    with pytest.raises(ValueError, match="object#1 touches no other object"):
        session.merge_with(None)
    low, high = scene.object(1).aabb.min, scene.object(1).aabb.max
    lower_half = ((low[0] - 1, low[1] - 1, low[2] - 1), (high[0], (low[1] + high[1]) / 2, high[2]))
    session.edit(lambda scene: scene.split(1, box=lower_half))
    new = session.scene.objects[-1].id
    session.select(1)
    (words,) = session.touching()
    assert words.startswith(f"object#{new} (")
    assert session.touching()[words] == new
    session.merge_with(session.touching()[words])
    assert ids(session) == [1]
    assert session.touching() == {}
    assert session.scene.object(1).num_gaussians == scene.object(1).num_gaussians
