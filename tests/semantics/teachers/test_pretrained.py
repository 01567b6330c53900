"""Teachers of transformers: tiny random models, against the library's own way through them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

pytest.importorskip("transformers")

from instok3d.semantics.teachers import open_teacher
from tiny_teachers import write_tiny_clip, write_tiny_dino, write_tiny_siglip

WRITERS: dict[str, tuple[str, Callable[[Path], Path]]] = {
    "clip": ("clip", write_tiny_clip),
    "siglip": ("siglip2", write_tiny_siglip),
    "siglip2": ("siglip2", lambda folder: write_tiny_siglip(folder, any_proportions=True)),
    "dinov2": ("dino", write_tiny_dino),
    "dinov2 with registers": (
        "dino",
        lambda folder: write_tiny_dino(folder, "dinov2_with_registers"),
    ),
    "dinov3": ("dino", lambda folder: write_tiny_dino(folder, "dinov3_vit")),
}
WITH_TEXT = ("clip", "siglip", "siglip2")


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    place = tmp_path_factory.mktemp("teachers")
    return {name: write(place / name) for name, (_, write) in WRITERS.items()}


@pytest.fixture(scope="module")
def teachers(folders: dict[str, Path]) -> dict[str, Any]:
    return {name: open_teacher(f"{kind}:{folders[name]}") for name, (kind, _) in WRITERS.items()}


def photo(height: int, width: int) -> Tensor:
    return torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(3))


@pytest.mark.parametrize("name", WRITERS)
def test_every_patch_has_a_unit_feature(teachers: dict[str, Any], name: str):
    # 32 x 32 pixels in patches of 8: 4 x 4; twice as wide with as many pixels: 45 x 23, 6 x 3.
    teacher = teachers[name]
    assert teacher.features(photo(32, 32)).shape == (1, teacher.channels, 4, 4)
    found = teacher.features(photo(100, 200).repeat(5, 1, 1, 1))
    assert found.shape == (5, teacher.channels, 3, 6)
    torch.testing.assert_close(found.norm(dim=1), torch.ones(5, 3, 6))
    assert not found.requires_grad
    assert teacher.name.startswith(f"{WRITERS[name][0]}-")


@pytest.mark.parametrize("name", WRITERS)
def test_thin_images_have_features(teachers: dict[str, Any], name: str):
    teacher = teachers[name]
    assert teacher.features(photo(1, 300)).shape[2] == 1
    assert float(teacher.crop(photo(300, 1)[0]).norm()) == pytest.approx(1, abs=1e-5)


def prepared(teacher: Any, image: Tensor) -> Tensor:
    mean, std = (torch.tensor(each)[:, None, None] for each in (teacher.MEAN, teacher.STD))
    return (image - mean) / std


@pytest.mark.parametrize("name", ["dinov2", "dinov2 with registers", "dinov3"])
def test_dino_gives_the_patches_of_its_last_layer(teachers: dict[str, Any], name: str):
    teacher, image = teachers[name], photo(32, 32)
    tokens = teacher._model(prepared(teacher, image)).last_hidden_state[0, -16:]
    torch.testing.assert_close(
        teacher.features(image)[0].flatten(1).T, normalize(tokens, dim=1), rtol=1e-4, atol=1e-5
    )


def test_dino_refuses_text(teachers: dict[str, Any]):
    with pytest.raises(ValueError, match=r"dino-\w+ knows images alone.*ask it with an image"):
        teachers["dinov2"].text(["chair"])


def test_clip_patches_see_only_themselves_in_the_last_layer(teachers: dict[str, Any]):
    # The library's own attention, masked so that each token sees itself alone.
    teacher, image = teachers["clip"], photo(32, 32)
    encoder = teacher._model.vision_model
    before = encoder(prepared(teacher, image), output_hidden_states=True).hidden_states[-2]
    last = encoder.encoder.layers[-1]
    torch.testing.assert_close(
        last(before, None), encoder(prepared(teacher, image)).last_hidden_state
    )
    alone = torch.full((17, 17), -torch.inf).fill_diagonal_(0)[None, None]
    with torch.no_grad():
        tokens, _ = last.self_attn(last.layer_norm1(before), attention_mask=alone)
        wanted = teacher._model.visual_projection(encoder.post_layernorm(tokens))[0, 1:]
    found = teacher.features(image)[0].flatten(1).T
    torch.testing.assert_close(found, normalize(wanted, dim=1), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ["siglip", "siglip2"])
def test_the_head_of_siglip_sees_each_patch_alone(teachers: dict[str, Any], name: str):
    teacher, image = teachers[name], photo(32, 32)
    tokens, _ = teacher._seen(image)
    with torch.no_grad():
        wanted = torch.cat(
            [teacher._model.vision_model.head(each[None, None])
             for each in tokens.last_hidden_state[0]]
        )  # fmt: skip
    found = teacher.features(image)[0].flatten(1).T
    torch.testing.assert_close(found, normalize(wanted, dim=1), rtol=1e-4, atol=1e-5)


def test_patches_of_any_proportions_are_those_of_the_library(teachers: dict[str, Any]):
    cut = pytest.importorskip("transformers.models.siglip2.image_processing_pil_siglip2")
    teacher, image = teachers["siglip2"], photo(16, 64)
    seen, rows = teacher._seen(image)
    assert rows == 2
    pixels = prepared(teacher, image)[0]
    patches = torch.as_tensor(cut.convert_image_to_patches(pixels.numpy(), 8))
    wanted = teacher._model.vision_model(
        pixel_values=patches[None],
        pixel_attention_mask=torch.ones(1, 16, dtype=torch.int64),
        spatial_shapes=torch.tensor([[2, 8]]),
    )
    torch.testing.assert_close(seen.last_hidden_state, wanted.last_hidden_state)


@pytest.mark.parametrize("name", ["clip", "siglip"])
def test_texts_and_crops_are_those_of_the_whole_model(teachers: dict[str, Any], name: str):
    teacher, image = teachers[name], photo(32, 32)
    ids = [[1, 3, 7], [1, 4, 3, 7]]
    length = 4 if name == "clip" else 8
    rows = torch.tensor([row + [0] * (length - len(row)) for row in ids])
    mask = (rows != 0).long() if name == "clip" else None
    with torch.no_grad():
        twin = teacher._model(
            input_ids=rows, pixel_values=prepared(teacher, image), attention_mask=mask
        )
    found = teacher.text(["chair", "red chair"])
    torch.testing.assert_close(found, twin.text_embeds, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(teacher.crop(image[0]), twin.image_embeds[0], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", WITH_TEXT)
def test_texts_get_unit_vectors_in_the_space_of_the_features(teachers: dict[str, Any], name: str):
    teacher = teachers[name]
    found = teacher.text(["the table", "red chair", "the table"])
    assert found.shape == (3, teacher.channels)
    torch.testing.assert_close(found.norm(dim=1), torch.ones(3))
    torch.testing.assert_close(found[0], found[2])
    assert teacher.text([]).shape == (0, teacher.channels)


@pytest.mark.parametrize("name", WITH_TEXT)
def test_bad_texts_are_refused(teachers: dict[str, Any], name: str):
    with pytest.raises(ValueError, match="the text '' is empty"):
        teachers[name].text([""])
    with pytest.raises(ValueError, match=r"'chair .* has 11 tokens, .* takes 8"):
        teachers[name].text(["chair " * 9])


def test_colours_are_normalised_as_the_folder_says(folders: dict[str, Path], tmp_path: Path):
    for file in folders["dinov2"].iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "preprocessor_config.json"
    path.write_text(json.dumps({"image_mean": [0.1, 0.2, 0.3], "image_std": [0.4, 0.5, 0.6]}))
    teacher = open_teacher(f"dino:{tmp_path}")
    assert teacher._mean.flatten().tolist() == pytest.approx([0.1, 0.2, 0.3])
    for wrong in ('{"image_mean": 3}', '{"image_std": [1, 0, 1]}', "[]", "{"):
        path.write_text(wrong)
        with pytest.raises(ValueError, match=r"preprocessor_config\.json is damaged"):
            open_teacher(f"dino:{tmp_path}")


def test_a_folder_without_tokenizer_is_refused(folders: dict[str, Path], tmp_path: Path):
    for name in ("config.json", "model.safetensors"):
        (tmp_path / name).write_bytes((folders["clip"] / name).read_bytes())
    with pytest.raises(FileNotFoundError, match=r"there is no tokenizer\.json in"):
        open_teacher(f"clip:{tmp_path}")
    for damaged in ("{}", "{", '{"version": "1.0", "model": {"type": "WordLevel"}}'):
        (tmp_path / "tokenizer.json").write_text(damaged)
        with pytest.raises(ValueError, match=r"tokenizer\.json cannot be read .*: fetch tokenizer"):
            open_teacher(f"clip:{tmp_path}")


def test_weights_of_another_model_are_refused(folders: dict[str, Path]):
    with pytest.raises(ValueError, match=r"model type 'clip', not 'siglip' or 'siglip2'"):
        open_teacher(f"siglip2:{folders['clip']}")
    with pytest.raises(FileNotFoundError, match=r"there is no config\.json"):
        open_teacher(f"clip:{folders['clip'] / 'nowhere'}")


@pytest.mark.parametrize("text", ["", "clip", "clip:", "resnet:folder", "folder"])
def test_a_text_that_names_no_teacher_is_refused(text: str):
    with pytest.raises(ValueError, match=r"names no teacher; wanted is one of lseg:FILE, clip:"):
        open_teacher(text)
