"""Semantics follow their scene: through edits, files, and into features of pixels."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import instok3d
from instok3d.cli.info import describe, summary
from instok3d.scene.edits.ownership import owners
from instok3d.scene.scene import Scene
from instok3d.scene.semantic_files import packed, unpacked
from instok3d.scene.semantics import (
    NO_SEMANTICS,
    SceneSemantics,
    check_encoder,
    merged,
    scene_semantics,
    with_part,
)
from instok3d.semantics.tokens import SemanticTokens
from made_scene import made_scene, made_semantics, made_tokens


def semantics(shared: list[float], anchors: int = 2) -> SceneSemantics:
    """One feature channel, one shared feature for each group."""
    return SceneSemantics(
        torch.tensor(shared)[:, None, None], torch.arange(float(anchors))[:, None],
        torch.ones(anchors, 1), torch.tensor([[2.0]]),
    )  # fmt: skip


def feature_of(scene: Scene, which: int) -> list[float]:
    """The first shared feature of an object."""
    return scene.semantics["made-3"].shared[which - 1, 0].tolist()


def test_the_papers_sizes_store_59392_numbers():
    papers = SceneSemantics(
        torch.zeros(100, 1, 512), torch.zeros(1024, 8), torch.ones(1024, 1), torch.zeros(512, 8)
    )
    assert papers.num_scalars == 59_392


def test_info_says_how_much_is_stored(scene: Scene):
    # 4 groups x 2 shared features of 3 channels, 10 anchors with 2 residuals and 2 shares each.
    line = "semantics: made-3, 64 numbers (4 groups x 2 x 3 + 10 anchors x 2 + 10 x 2)"
    assert line in describe(scene).splitlines()
    assert summary(scene)["semantics"] == {"made-3": 64}
    bare = replace(scene, semantics={"made-3": made_semantics(scene, basis=1)})
    assert "made-3, 32 numbers (4 groups x 3 + 10 anchors x 2)" in describe(bare)
    assert "semantics:" not in describe(replace(scene, semantics={}))


def test_numbers_are_those_that_the_file_holds():
    raw = SemanticTokens(
        torch.full((1, 2, 1, 3), 1 / 3), torch.full((1, 4, 2), 0.1), torch.ones(1, 4, 1),
        torch.full((3, 2), 0.7),
    )  # fmt: skip
    found = scene_semantics(raw)
    assert torch.equal(found.shared, torch.full((2, 1, 3), 1 / 3).half().float())
    with pytest.raises(ValueError, match="residuals that are not finite"):
        scene_semantics(replace(raw, residuals=raw.residuals / 0))
    with pytest.raises(ValueError, match="batch of one, got 2"):
        scene_semantics(
            SemanticTokens(
                torch.ones(2, 2, 1, 3), torch.ones(2, 4, 2), torch.ones(2, 4, 1), torch.ones(3, 2)
            )
        )


def test_merged_groups_have_the_mean_of_what_is_known():
    pi = torch.eye(5)[:2]
    found = merged({"a": semantics([1.0, 4.0, 0.0, 7.0])}, {1: 3.0, 0: 1.0, 2: 5.0}, pi)["a"]
    # (3 x 4 + 1 x 1) / 4; group 2 is not known, group 3 is not among them.
    assert found.shared.flatten().tolist() == [1.0, 3.25, 0.0, 7.0]
    nothing = merged({"a": semantics([0.0, 0.0])}, {0: 1.0, 1: 1.0}, torch.eye(3)[:2])["a"]
    assert nothing.shared.flatten().tolist() == [0.0, 0.0]


def halves() -> SceneSemantics:
    """Two groups with an anchor each: the same two features, the other way round."""
    return SceneSemantics(
        torch.tensor([[[1.0, 0.0], [0.0, 1.0]], [[0.0, 3.0], [1.0, 0.0]]]), torch.zeros(2, 1),
        torch.tensor([[0.75, 0.25], [0.75, 0.25]]), torch.zeros(2, 1),
    )  # fmt: skip


def test_a_group_has_of_its_features_what_its_anchors_have():
    found = halves().of_groups(torch.eye(3)[:2])
    assert found.tolist() == [[0.75, 0.25], [0.25, 2.25]]
    # Both anchors are of group 0: of group 1 nobody knows which, it has half of each.
    both = halves().of_groups(torch.eye(3)[[0, 0]])
    assert both.tolist() == [[0.75, 0.25], [0.5, 1.5]]
    lost = halves().of_objects([1], torch.eye(3)[[2, 2]])
    torch.testing.assert_close(lost, torch.tensor([[0.5, 0.5]]) * 2**0.5)


def test_merged_groups_keep_their_parts_apart():
    found = merged({"a": halves()}, {0: 1.0, 1: 1.0}, torch.eye(3)[:2])["a"]
    # Group 1's second feature is like group 0's first one: they are averaged, and so on.
    assert found.shared[0].tolist() == [[1.0, 0.0], [0.0, 2.0]]
    assert found.mixing.tolist() == [[0.75, 0.25], [0.25, 0.75]]
    assert torch.equal(found.residuals, halves().residuals)


def test_a_part_brings_what_the_same_encoder_says_and_nothing_else():
    scene = {"a": semantics([1.0, 2.0]), "b": semantics([3.0, 4.0])}
    found = with_part(scene, {"a": semantics([5.0], 1), "c": semantics([6.0], 1)}, 1)
    assert list(found) == ["a", "b"]
    assert found["a"].shared.flatten().tolist() == [1, 2, 5]
    assert found["a"].residuals.flatten().tolist() == [0, 1, 0]
    assert found["b"].shared.flatten().tolist() == [3, 4, 0]
    other_model = replace(semantics([5.0], 1), residual_map=torch.tensor([[9.0]]))
    assert with_part(scene, {"a": other_model}, 1)["a"].shared.flatten().tolist() == [1, 2, 0]
    assert with_part(NO_SEMANTICS, {"a": other_model}, 1) == {}


def test_edits_carry_the_features_of_objects(scene: Scene):
    first, third = feature_of(scene, 1), feature_of(scene, 3)
    assert first != third
    double = scene.duplicate(3, (0.2, 0, 0))
    assert feature_of(double, 5) == third
    inserted = scene.insert(made_scene(made_tokens()), 1, (0, 0.3, 1.5))
    assert feature_of(inserted, 5) == first
    foreign = replace(made_scene(made_tokens()), semantics={})
    assert feature_of(scene.insert(foreign, 1, (0, 0.3, 1.5)), 5) == [0, 0, 0]
    low, high = scene.object(1).aabb.min, scene.object(1).aabb.max
    half = ((-9.0, -9.0, -9.0), ((low[0] + high[0]) / 2, 9.0, 9.0))
    assert feature_of(scene.split(1, box=half), 5) == first
    counts = scene.object(1).num_gaussians, scene.object(3).num_gaussians
    # The two shared features of each may change places: what stays is their mean.
    means = [scene.semantics["made-3"].shared[which - 1].mean(dim=0) for which in (1, 3)]
    mean = (counts[0] * means[0] + counts[1] * means[1]) / sum(counts)
    found = scene.merge(3, 1).semantics["made-3"].shared[2].mean(dim=0)
    torch.testing.assert_close(found, mean, atol=1e-3, rtol=0)


def test_what_is_left_of_a_scene_looks_as_before_to_an_encoder(scene: Scene):
    before = scene.render_features("made-3")
    assert before.shape == (2, 3, scene.height, scene.width)
    moved = scene.move(3, (50.0, 0, 0)).remove(3)
    without = scene.remove(3)
    assert torch.equal(moved.render_features("made-3"), without.render_features("made-3"))
    assert torch.equal(scene.remove(3).undo().render_features("made-3"), before)


def test_features_of_pixels_are_those_of_equation_7(scene: Scene):
    one = made_semantics(scene, basis=1)
    bare = replace(one, residuals=torch.zeros_like(one.residuals))
    known = replace(scene, semantics={"made-3": bare})
    found = known.render_features("made-3", [0])[0]
    pictures = scene.render([0], ids=True)
    assert pictures.ids is not None
    whole = (pictures.ids[0] == 1) & (pictures.alphas[0] > 0.98)
    # The other groups shine through where the first is not quite opaque.
    assert whole.any()
    nearest = torch.cdist(found[:, whole].T, bare.of_groups(scene.tokens.assignment)).argmin(dim=1)
    assert (nearest == 0).float().mean() > 0.9
    assert int(owners(scene.tokens).max()) <= len(bare.shared)


def test_an_encoder_that_is_not_there_is_named(scene: Scene):
    with pytest.raises(KeyError, match="no semantics of 'lseg'; there are: made-3"):
        scene.render_features("lseg")
    with pytest.raises(KeyError, match="there are: none"):
        replace(scene, semantics={}).render_features("lseg")


def test_hidden_objects_have_no_features(scene: Scene):
    hidden = scene.hide(1).render_features("made-3")
    assert torch.equal(hidden, scene.remove(1).render_features("made-3"))


def test_objects_name_their_row(tmp_path: Path, scene: Scene, empty_scene: Scene):
    scene.save(tmp_path / "a.itk")
    rows = json.loads((tmp_path / "a.itk/objects.json").read_text())["objects"]
    assert [each["embedding_row"] for each in rows] == [0, 2]
    replace(scene, semantics={}).save(tmp_path / "b.itk")
    rows = json.loads((tmp_path / "b.itk/objects.json").read_text())["objects"]
    assert [each["embedding_row"] for each in rows] == [None, None]
    assert "semantics" not in json.loads((tmp_path / "b.itk/scene.json").read_text())
    assert not (tmp_path / "b.itk/semantics").exists()


DAMAGE = {
    "is missing": lambda file: file.unlink(),
    "is damaged: it is not the file": lambda file: file.write_bytes(file.read_bytes()[:-1] + b"x"),
}


@pytest.mark.parametrize("message", DAMAGE)
def test_damage_is_refused(tmp_path: Path, scene: Scene, message: str):
    scene.save(tmp_path / "a.itk")
    DAMAGE[message](tmp_path / "a.itk/semantics/made-3.safetensors")
    with pytest.raises((FileNotFoundError, ValueError), match=message):
        instok3d.load(tmp_path / "a.itk")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("shared", torch.zeros(3, 2, 3).half(), r"shared is torch.float16 \(3, 2, 3\)"),
        ("shared", torch.zeros(4).half(), r"shared is torch.float16 \(4,\)"),
        ("residuals", torch.zeros(3, 2).half(), r"residuals is torch.float16 \(3, 2\)"),
        ("mixing", torch.full((10, 2), torch.inf).half(), "mixing holds numbers that are not fin"),
        ("mixing", torch.ones(10, 2), "mixing is torch.float32"),
        ("residual_map", torch.zeros(3, 4).half(), r"residuals is torch.float16 \(10, 2\)"),
        ("else", torch.zeros(3), "wanted the tensors .* found .*'else'"),
    ],
)
def test_what_does_not_fit_the_scene_is_refused(
    scene: Scene, name: str, value: torch.Tensor, message: str
):
    tensors = packed(scene.semantics)
    assert list(unpacked(tensors, groups=4, anchors=10)) == ["made-3"]
    with pytest.raises(ValueError, match=message):
        unpacked({**tensors, f"semantics/made-3/{name}": value}, groups=4, anchors=10)


@pytest.mark.parametrize("name", ["", "../a", "A", "a/b", ".a", "a" * 65, "a b"])
def test_names_of_encoders_are_names_of_files(tmp_path: Path, scene: Scene, name: str):
    with pytest.raises(ValueError, match="is no name of an encoder"):
        check_encoder(name)
    with pytest.raises(ValueError, match="is no name of an encoder"):
        replace(scene, semantics={name: scene.semantics["made-3"]}).save(tmp_path / "a.itk")
    assert not (tmp_path / "a.itk").exists()
