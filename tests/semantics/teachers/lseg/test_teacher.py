from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from instok3d.semantics.teachers import open_teacher
from instok3d.semantics.teachers.lseg import LSegTeacher, label_scores
from instok3d.weights.conversion import convert_checkpoint
from tiny_lseg import published_state, write_merges


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkpoint of a training run, converted, with CLIP's list beside it."""
    folder = tmp_path_factory.mktemp("lseg")
    torch.save({"epoch": 200, "state_dict": published_state()}, folder / "demo_e200.ckpt")
    convert_checkpoint(folder / "demo_e200.ckpt", folder / "lseg.safetensors")
    write_merges(folder)
    return folder / "lseg.safetensors"


@pytest.fixture(scope="module")
def teacher(weights: Path) -> LSegTeacher:
    return open_teacher(f"lseg:{weights}")


def test_features_are_of_unit_length_at_half_the_resolution(teacher: LSegTeacher):
    found = teacher.features(torch.rand(2, 3, 64, 96))
    assert found.shape == (2, teacher.channels, 32, 48)
    torch.testing.assert_close(found.norm(dim=1), torch.ones(2, 32, 48))


def test_other_sizes_are_stretched_to_multiples_of_32(teacher: LSegTeacher):
    assert teacher.features(torch.rand(1, 3, 70, 5)).shape[2:] == (32, 16)


def test_the_network_sees_values_from_minus_one_to_one(teacher: LSegTeacher):
    # A grey image of .5 is 0 to the network, so that its kernel cannot matter.
    grey = torch.full((1, 3, 32, 32), 0.5)
    before = teacher.features(grey)
    kernel = teacher._pretrained.model.patch_embed.proj.weight
    with torch.no_grad():
        kernel.mul_(2)
        torch.testing.assert_close(teacher.features(grey), before)
        assert not torch.allclose(teacher.features(0 * grey), before)
        kernel.div_(2)


def test_many_images_give_what_each_gives_alone(teacher: LSegTeacher):
    images = torch.rand(5, 3, 32, 32)
    alone = torch.cat([teacher.features(each[None]) for each in images])
    torch.testing.assert_close(teacher.features(images), alone, rtol=1e-4, atol=1e-5)


def test_texts_get_unit_vectors(teacher: LSegTeacher):
    found = teacher.text(["chair", "door", "Chair"])
    assert found.shape == (3, teacher.channels)
    torch.testing.assert_close(found.norm(dim=1), torch.ones(3))
    torch.testing.assert_close(found[0], found[2])
    assert found[0] @ found[1] < 0.999
    assert teacher.text([]).shape == (0, teacher.channels)


def test_a_crop_is_a_unit_vector_in_the_same_space(teacher: LSegTeacher):
    found = teacher.crop(torch.rand(3, 40, 20))
    assert found.shape == (teacher.channels,)
    assert float(found.norm()) == pytest.approx(1, abs=1e-5)


def test_an_empty_text_is_refused(teacher: LSegTeacher):
    with pytest.raises(ValueError, match="the text ' ' is empty: describe what to look for"):
        teacher.text(["chair", " "])


def test_no_image_is_refused(teacher: LSegTeacher):
    with pytest.raises(ValueError, match=r"nothing to look at: images of shape \(0, 3, 32, 32\)"):
        teacher.features(torch.zeros(0, 3, 32, 32))


def test_the_name_tells_weights_apart(weights: Path, teacher: LSegTeacher, tmp_path: Path):
    save_file(published_state(seed=1), tmp_path / "other.safetensors")
    write_merges(tmp_path)
    other = LSegTeacher(tmp_path / "other.safetensors")
    assert LSegTeacher(weights).name == teacher.name != other.name
    assert teacher.name.startswith("lseg-")


def test_scores_of_labels_by_hand():
    # One pixel along the first axis: cosine 1 and 0; times 1 / .07 = 14.2857, doubled in size.
    scores = label_scores(torch.tensor([3.0, 0]).view(1, 2, 1, 1), torch.eye(2))
    assert scores.shape == (1, 2, 2, 2)
    torch.testing.assert_close(scores[0, 0], torch.full((2, 2), 14.2857), rtol=1e-4, atol=0)
    assert not scores[0, 1].any()


def test_missing_files_are_named(weights: Path, tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"no weights of LSeg in .*: see docs/models\.md"):
        LSegTeacher(tmp_path / "lseg.safetensors")
    (tmp_path / "alone.safetensors").write_bytes(weights.read_bytes())
    with pytest.raises(FileNotFoundError, match=r"there is no .*merges\.txt"):
        LSegTeacher(tmp_path / "alone.safetensors")


def test_a_list_of_another_tokenizer_is_refused(weights: Path, tmp_path: Path):
    (tmp_path / "lseg.safetensors").write_bytes(weights.read_bytes())
    (tmp_path / "merges.txt").write_text("#version: 0.2\nc h\n")
    with pytest.raises(ValueError, match=r"merges\.txt makes 515 tokens, .* knows 520"):
        LSegTeacher(tmp_path / "lseg.safetensors")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda state: state.clear(), "not LSeg's"),
        (lambda state: state.pop("net.pretrained.model.pos_embed"), "not LSeg's"),
        (lambda state: state.pop("net.pretrained.model.blocks.3.norm1.weight"), "does not hold"),
        (lambda state: state.update({"net.scratch.head1.weight": torch.zeros(1)}), "not LSeg's"),
        (lambda state: state.update({"net.extra": torch.zeros(1)}), "does not hold LSeg"),
        (
            lambda state: state.update({"net.scratch.head1.bias": torch.full((12,), torch.nan)}),
            "not finite",
        ),
    ],
)
def test_other_tensors_are_refused(tmp_path: Path, change, message: str):
    state = published_state()
    change(state)
    save_file(state, tmp_path / "lseg.safetensors")
    write_merges(tmp_path)
    with pytest.raises(ValueError, match=rf"lseg\.safetensors .*{message}.*convert the checkpoint"):
        LSegTeacher(tmp_path / "lseg.safetensors")


def test_a_cut_file_is_refused(weights: Path, tmp_path: Path):
    (tmp_path / "lseg.safetensors").write_bytes(weights.read_bytes()[:5000])
    with pytest.raises(ValueError, match="not a whole safetensors file"):
        LSegTeacher(tmp_path / "lseg.safetensors")
