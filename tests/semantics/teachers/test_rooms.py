"""The embedded teacher, and its file."""

from pathlib import Path

import pytest
import torch
from torch.nn import functional

from instok3d.files import write_safetensors
from instok3d.semantics.eight_bits import rounded
from instok3d.semantics.predictor import Predictor, PredictorConfig
from instok3d.semantics.teacher import Teacher
from instok3d.semantics.teachers import open_teacher
from instok3d.semantics.teachers.file import load_teacher, save_teacher, teacher_tensors
from instok3d.semantics.teachers.rooms import RoomTeacher
from instok3d.semantics.text import quantized
from instok3d.semantics.wordpiece import UNKNOWN
from mutations import of_safetensors, survive


@pytest.fixture
def teacher() -> RoomTeacher:
    torch.manual_seed(0)
    config = PredictorConfig(
        channels=8, width=16, layers=1, head_width=8, quarter_channels=16, half_channels=16
    )
    words = (UNKNOWN, "sofa", "red", "chair")
    table = quantized(torch.randn(4, 8), words, "made up")
    return RoomTeacher(Predictor(config), table, credits=["Chair by A, CC0-1.0"])


@pytest.fixture
def path(tmp_path: Path, teacher: RoomTeacher) -> Path:
    save_teacher(teacher, tmp_path / "teacher.safetensors")
    return tmp_path / "teacher.safetensors"


def test_it_is_a_teacher(teacher: RoomTeacher):
    assert isinstance(teacher, Teacher)
    assert teacher.text(["red sofa", "chair"]).shape == (2, teacher.channels)
    assert teacher.text([]).shape == (0, teacher.channels)


@pytest.mark.parametrize(
    ("size", "cells"), [((128, 128), (64, 64)), ((64, 96), (64, 96)), ((300, 150), (128, 64))]
)
def test_photos_of_any_size_are_looked_at_with_128_pixels(
    teacher: RoomTeacher, size: tuple[int, int], cells: tuple[int, int]
):
    assert teacher.features(torch.rand(1, 3, *size)).shape == (1, 8, *cells)
    assert teacher.features(torch.rand(0, 3, *size)).shape == (0, 8, *cells)


def test_a_mirror_image_has_the_mirrored_features(teacher: RoomTeacher):
    image = torch.rand(1, 3, 32, 128)
    found = teacher.features(image)
    torch.testing.assert_close(teacher.features(image.flip(-1)), found.flip(-1))
    large = functional.interpolate(image, (128, 512), mode="bilinear", align_corners=False)
    with torch.no_grad():
        one, other = teacher.predictor(large), teacher.predictor(large.flip(-1)).flip(-1)
    assert not torch.allclose(one, other, atol=1e-3)
    torch.testing.assert_close(teacher.features(large), (one + other) / 2)


def test_a_crop_is_the_mean_direction_of_its_middle(teacher: RoomTeacher):
    image = torch.rand(3, 128, 128)
    directions = functional.normalize(teacher.features(image[None])[0], dim=0)
    wanted = functional.normalize(directions[:, 16:48, 16:48].mean(dim=(1, 2)), dim=0)
    torch.testing.assert_close(teacher.crop(image), wanted)
    assert teacher.crop(torch.rand(3, 1, 1)).norm() == pytest.approx(1)


def test_what_was_written_is_read_back_up_to_rounding(teacher: RoomTeacher, path: Path):
    again = load_teacher(path)
    assert open_teacher(f"rooms:{path}").name == teacher.name
    assert (again.name, again.channels) == (teacher.name, teacher.channels)
    assert again.table.source == teacher.table.source
    assert again.credits == teacher.credits == ("Chair by A, CC0-1.0",)
    assert again.text(["red sofa"]).equal(teacher.text(["red sofa"]))
    images = torch.rand(1, 3, 128, 128)
    cosines = functional.cosine_similarity(teacher.features(images), again.features(images))
    assert cosines.min() > 0.99
    save_teacher(again, path, overwrite=True)
    assert load_teacher(path).features(images).equal(again.features(images))
    with pytest.raises(FileExistsError):
        save_teacher(teacher, path)


def test_others_may_lie_in_the_same_file(teacher: RoomTeacher, tmp_path: Path):
    tensors, metadata = teacher_tensors(teacher)
    shared = tmp_path / "shared.safetensors"
    write_safetensors(
        shared, tensors | {"decoder.weight": torch.ones(2)}, metadata | {"format": "another"}
    )
    assert load_teacher(shared).name == teacher.name


def test_rounding_costs_half_a_step_at_most():
    values = torch.randn(5, 3, 2, 2)
    rows, scales = rounded(values)
    restored = rows.float() * scales.view(-1, 1, 1, 1)
    assert ((restored - values).abs() <= scales.view(-1, 1, 1, 1) * 0.501).all()
    assert rounded(torch.zeros(2, 3))[0].eq(0).all()


def test_a_missing_file_and_one_without_a_teacher_are_refused(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match="there is no teacher"):
        load_teacher(tmp_path / "none.safetensors")
    write_safetensors(tmp_path / "other.safetensors", {"a": torch.ones(1)})
    with pytest.raises(ValueError, match="holds no teacher"):
        load_teacher(tmp_path / "other.safetensors")


def test_a_damaged_file_is_read_or_refused_in_one_line(path: Path):
    assert survive(path, lambda: load_teacher(path), of_safetensors, 150)
