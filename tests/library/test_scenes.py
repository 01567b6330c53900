import io
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from instok3d.library.scenes import THUMBNAIL, choose_encoder, entries_of
from instok3d.scene.semantics import NO_SEMANTICS
from made_scene import made_empty_scene, made_scene, made_tokens


def test_the_entries_are_the_objects_with_the_mean_of_their_features():
    scene = made_scene(made_tokens())
    entries = entries_of(scene, "made-3", "room.itk")
    assert [each.id for each in entries.objects] == [item.id for item in scene.objects]
    assert [each.key for each in entries.objects] == [item.key for item in scene.objects]
    # By hand: of object 3, what its anchors have of its two shared features, in the mean.
    semantics, owners = scene.semantics["made-3"], scene.tokens.assignment.argmax(dim=1)
    share = semantics.mixing[owners == 2].sum(dim=0)
    share = share / share.sum()  # halves in 16 bits do not quite sum to 1
    third = [item.id for item in scene.objects].index(3)
    wanted = (share[:, None] * semantics.shared[2]).sum(dim=0)
    np.testing.assert_allclose(entries.embeddings[third], wanted.numpy(), rtol=1e-5)
    features = semantics.of_groups(scene.tokens.assignment)
    for row, item in zip(entries.embeddings, scene.objects, strict=True):
        np.testing.assert_allclose(row, features[item.id - 1].numpy(), rtol=1e-6)
    first = scene.objects[0]
    np.testing.assert_allclose(entries.objects[0].box, [first.aabb.min, first.aabb.max], rtol=1e-6)


def test_a_thumbnail_shows_the_object_on_white():
    # Object 1 is red, see made_tokens.
    entries = entries_of(made_scene(made_tokens()), "made-3", "room.itk")
    picture = Image.open(io.BytesIO(entries.objects[0].thumbnail))
    assert picture.format == "JPEG"
    assert max(picture.size) <= THUMBNAIL
    pixels = np.asarray(picture, np.float32)
    assert pixels[..., 0].mean() > pixels[..., 2].mean() + 20


def test_hidden_objects_are_left_out():
    scene = made_scene(made_tokens())
    hidden = replace(scene, objects=(replace(scene.objects[0], hidden=True), *scene.objects[1:]))
    found = entries_of(hidden, "made-3", "room.itk")
    assert [each.id for each in found.objects] == [item.id for item in scene.objects[1:]]


def test_objects_without_features_are_left_out_with_a_warning():
    scene = made_scene(made_tokens())
    known = scene.semantics["made-3"]
    shared = known.shared.clone()
    shared[scene.objects[0].id - 1] = 0
    scene = replace(scene, semantics={"made-3": replace(known, shared=shared)})
    count = len(scene.objects)
    with pytest.warns(
        UserWarning, match=f"room.itk: 1 of {count} objects have no features of made"
    ):
        found = entries_of(scene, "made-3", "room.itk")
    assert len(found.objects) == count - 1


def test_a_scene_without_objects_has_no_entries():
    found = entries_of(made_empty_scene(), "made-3", "room.itk")
    assert found.embeddings.shape == (0, 3)


def test_the_encoder_is_chosen_where_there_is_a_choice():
    scene = made_scene(made_tokens())
    assert choose_encoder(scene, "room.itk", None) == "made-3"
    other = scene.semantics["made-3"].map(torch.clone)
    two = replace(scene, semantics={**scene.semantics, "other": other})
    with pytest.raises(ValueError, match=r"several encoders, made-3, other: give --encoder"):
        choose_encoder(two, "room.itk", None)
    assert choose_encoder(two, "room.itk", "other") == "other"
    with pytest.raises(ValueError, match=r"no semantics of 'third'; it has those of made-3"):
        choose_encoder(scene, "room.itk", "third")
    with pytest.raises(ValueError, match=r"room\.itk has no semantics, so that nothing"):
        choose_encoder(replace(scene, semantics=NO_SEMANTICS), "room.itk", None)
