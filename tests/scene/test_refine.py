import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from PIL import Image

import instok3d
from instok3d.files import sha256_of
from instok3d.pictures import color_picture
from instok3d.scene.record import RefinementRecord
from instok3d.scene.scene import Scene
from made_scene import HEIGHT, WIDTH, made_scene, made_tokens

TALL, WIDE = 2 * HEIGHT, 2 * WIDTH


@pytest.fixture(scope="module")
def sharp() -> Scene:
    scene = made_scene(made_tokens(num_views=3))
    return replace(scene, photos=torch.from_numpy(color_picture(scene.render().colors)))


@pytest.fixture
def pale(sharp: Scene) -> Scene:
    """The scene in half the contrast, with the photos of the sharp one."""
    return replace(sharp, gaussians=replace(sharp.gaussians, sh=0.5 * sharp.gaussians.sh))


@pytest.fixture
def with_files(pale: Scene, sharp: Scene, tmp_path: Path) -> tuple[Scene, Path]:
    """The pale scene, made from photos of twice its size that lie in a folder."""
    folder = tmp_path / "photos"
    folder.mkdir()
    pictures = color_picture(sharp.render(height=TALL, width=WIDE).colors)
    views = []
    for index, (view, picture) in enumerate(zip(pale.views, pictures, strict=True)):
        file = folder / f"p{index}.png"
        Image.fromarray(picture).save(file)
        pixel_map = replace(
            view.pixel_map, original_height=TALL, original_width=WIDE, scale_x=0.5, scale_y=0.5,
            offset_x=0.0, offset_y=0.0,
        )  # fmt: skip
        views.append(replace(view, file=file.name, sha256=sha256_of(file), pixel_map=pixel_map))
    return replace(pale, views=tuple(views)), folder


def error(scene: Scene, sharp: Scene, height: int = HEIGHT) -> float:
    shown = [each.render(height=height).colors for each in (scene, sharp)]
    return float((shown[0] - shown[1]).abs().mean())


def test_refining_nears_the_photos_and_says_so(pale: Scene, sharp: Scene, tmp_path: Path):
    told: list[str] = []
    refined = instok3d.refine(pale, steps=40, progress=told.append)
    assert error(refined, sharp) < 0.4 * error(pale, sharp)
    (record,) = refined.provenance.refinements
    assert (record.steps, record.height, record.width) == (40, HEIGHT, WIDTH)
    assert record.psnr_after > record.psnr_before + 6
    assert told[-1].startswith("refinement: step 40 of 40, ")
    assert [item.id for item in refined.objects] == [item.id for item in pale.objects]
    assert refined.near_far == pale.near_far
    assert refined.tokens is pale.tokens
    refined.save(tmp_path / "room.itk")
    back = instok3d.load(tmp_path / "room.itk")
    assert back.provenance == refined.provenance
    header = json.loads((tmp_path / "room.itk" / "scene.json").read_text())
    assert header["tokens_give_gaussians"] is False
    assert header["provenance"]["refinements"][0]["steps"] == 40


def test_boxes_follow_the_gaussians(pale: Scene):
    refined = instok3d.refine(pale, steps=20)
    assert [item.aabb for item in refined.objects] != [item.aabb for item in pale.objects]


def test_the_photos_files_can_be_looked_at_with_more_pixels(with_files, sharp: Scene):
    scene, folder = with_files
    refined = instok3d.refine(scene, folder, steps=40, pixels=TALL)
    assert error(refined, sharp, TALL) < 0.5 * error(scene, sharp, TALL)
    assert refined.provenance.refinements[0].height == TALL


def test_photos_are_known_by_their_bytes_whatever_their_names(with_files):
    scene, folder = with_files
    for file in sorted(folder.iterdir()):
        file.rename(folder / f"z{9 - int(file.stem[1])}.png")
    Image.new("RGB", (WIDE, TALL)).save(folder / "another.png")
    plain = instok3d.refine(scene, folder, steps=2)
    assert plain.provenance.refinements[0].steps == 2
    (folder / "z9.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"1 of the scene's 3 photos .* p0.png"):
        instok3d.refine(scene, folder, steps=2)


def test_what_cannot_be_done_is_refused(pale: Scene, tmp_path: Path):
    with pytest.raises(ValueError, match="give the photos"):
        instok3d.refine(pale, pixels=TALL)
    with pytest.raises(ValueError, match="steps of refinement"):
        instok3d.refine(pale, steps=-1)
    with pytest.raises(ValueError, match="height must be"):
        instok3d.refine(pale, pixels=0)
    with pytest.raises(FileNotFoundError, match="masks"):
        instok3d.refine(pale, masks=tmp_path / "none")


def test_no_step_gives_the_scene_back(pale: Scene):
    assert instok3d.refine(pale, steps=0) is pale


def test_a_scene_without_objects_can_be_refined(empty_scene: Scene):
    assert instok3d.refine(empty_scene, steps=2).objects == ()


def test_a_stop_keeps_what_was_reached_and_warns(pale: Scene):
    left = iter([False] * 3)
    with pytest.warns(UserWarning, match="ended after 3 of 40 steps"):
        refined = instok3d.refine(pale, steps=40, stop=lambda: next(left, True))
    assert refined.provenance.refinements[0].steps == 3


def test_masks_are_those_of_the_photos(with_files, tmp_path: Path):
    scene, _folder = with_files
    masks = tmp_path / "masks"
    masks.mkdir()
    mask = Image.new("L", (WIDE, TALL), 0)
    mask.paste(255, (0, 0, WIDE // 2, TALL))
    mask.save(masks / "p1.png")
    once = instok3d.refine(scene, masks=masks, steps=3)
    spoilt = scene.photos.clone()
    spoilt[1, :, WIDTH // 2 :] = 255
    again = instok3d.refine(replace(scene, photos=spoilt), masks=masks, steps=3)
    assert torch.equal(once.gaussians.sh, again.gaussians.sh)
    Image.new("L", (WIDE + 2, TALL), 255).save(masks / "p2.png.png")
    with pytest.raises(ValueError, match=r"p2.png.png is 48 x 66, its photo 48 x 64"):
        instok3d.refine(scene, masks=masks, steps=3)
    (masks / "p2.png.png").rename(masks / "other.png")
    with pytest.warns(UserWarning, match="1 files of .* left out: other.png"):
        instok3d.refine(scene, masks=masks, steps=1)
    (masks / "p1.png").unlink()
    with pytest.raises(ValueError, match=r"no file of .* is named as a photo"):
        instok3d.refine(scene, masks=masks, steps=3)


def test_refinements_add_up(pale: Scene):
    twice = instok3d.refine(instok3d.refine(pale, steps=2), steps=3, densify=0.1)
    steps = [(each.steps, each.split_share) for each in twice.provenance.refinements]
    assert steps == [(2, 0.0), (3, 0.1)]
    assert isinstance(twice.provenance.refinements[0], RefinementRecord)
    assert len(twice.gaussians.means) == len(pale.gaussians.means) + 4


def test_a_gaussian_that_shows_another_object_goes_to_it(sharp: Scene):
    """One of the red blob's, taken for the blue one's."""
    red, blue = sharp.objects
    wrong = sharp.gaussians.anchor_index.clone()
    wrong[red.gaussian_range[0]] = sharp.gaussians.anchor_index[blue.gaussian_range[0]]
    mistaken = replace(sharp, gaussians=replace(sharp.gaussians, anchor_index=wrong))
    refined = instok3d.refine(mistaken, steps=1)
    assert [item.num_gaussians for item in refined.objects] == [
        red.num_gaussians, blue.num_gaussians
    ]  # fmt: skip
