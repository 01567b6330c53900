from dataclasses import replace

import numpy as np
import pytest
import torch

from imported_scene import imported_scene
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.scene.scene import Scene
from instok3d.viewer import splats as module
from instok3d.viewer.session import Shown
from instok3d.viewer.splats import drawn_alike, parts_of, seen_from, splats_of
from made_scene import made_empty_scene, made_scene, made_tokens


@pytest.fixture
def scene() -> Scene:
    return made_scene(made_tokens())


def rows_of(scene: Scene, shown: Shown) -> dict[int, list[int]]:
    every = torch.arange(len(scene.gaussians.means))
    return {number: every[part.rows].tolist() for number, part in parts_of(shown).items()}


def test_every_gaussian_is_drawn_once_and_hidden_ones_never(scene: Scene):
    # Objects 1 and 3 have 12 and 8 Gaussians, the rest 20.
    expected = {1: list(range(12)), 3: list(range(12, 20)), 0: list(range(20, 40))}
    assert rows_of(scene, Shown(scene)) == expected
    hidden = scene.hide(1)
    del expected[1]
    assert rows_of(hidden, Shown(hidden, frozenset({1}))) == expected


def test_small_objects_are_drawn_together_unless_they_are_selected(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "OWN_PARTS", 1)
    scene = imported_scene((1, 2, 2, 3, 0))
    assert {k: len(v) for k, v in rows_of(scene, Shown(scene)).items()} == {2: 20, 0: 30}
    chosen = rows_of(scene, Shown(scene, frozenset({3})))
    assert {k: len(v) for k, v in chosen.items()} == {2: 20, 3: 10, 0: 20}
    assert sorted(row for rows in chosen.values() for row in rows) == list(range(50))


def test_nothing_is_no_part():
    empty = made_empty_scene()
    assert parts_of(Shown(replace(empty, gaussians=empty.gaussians.rows(slice(0, 0))))) == {}


def test_colours_are_those_of_a_picture_from_that_point(scene: Scene):
    # One flat opaque Gaussian that fills the picture: its colour is the pixel's.
    one = scene.gaussians.rows(slice(0, 1))
    wide = replace(
        one, means=torch.tensor([[0.3, -0.2, 2.0]]), scales=torch.full((1, 3), 9.0),
        opacities=torch.ones(1),
    )  # fmt: skip
    alone = replace(scene, gaussians=wide, objects=())
    pixel = alone.render([0]).colors[0, :, 12, 16]
    color = seen_from(wide, (0.0, 0.0, 0.0))[0]
    torch.testing.assert_close(color * 0.99, pixel.clamp(0, 1), atol=2e-3, rtol=0)


def test_covariances_are_those_of_the_gaussians_in_units_of_their_size(scene: Scene):
    # A scene whose splats are so small that half precision would lose them.
    tiny = replace(scene, gaussians=replace(
        scene.gaussians, means=scene.gaussians.means * 1e-4, scales=scene.gaussians.scales * 1e-4
    ))  # fmt: skip
    part = parts_of(Shown(tiny))[1]
    drawn = splats_of(tiny, part, (0.0, 0.0, 0.0))
    own = tiny.gaussians.rows(part.rows)
    np.testing.assert_allclose(drawn.centers * drawn.unit, own.means.numpy(), rtol=1e-5)
    axes = quat_to_matrix(own.quats.double())
    expected = axes @ torch.diag_embed(own.scales.double() ** 2) @ axes.mT
    half = drawn.covariances.astype(np.float16).astype(np.float64) * drawn.unit**2
    assert np.abs(half - expected.numpy()).max() < 1e-3 * float(expected.abs().max())


def test_tints_show_what_is_selected_and_which_object_is_which(scene: Scene):
    plain = splats_of(scene, parts_of(Shown(scene))[1], (0.0, 0.0, 0.0)).colors
    chosen = parts_of(Shown(scene, frozenset({1})))
    lit = splats_of(scene, chosen[1], (0.0, 0.0, 0.0)).colors
    assert np.allclose(lit, 0.5 * plain + 0.5 * np.array([1.0, 0.75, 0.1]), atol=1e-6)
    assert not chosen[3].tints.any()
    ids = parts_of(Shown(scene, instance_colors=True))
    assert not ids[0].tints.any()
    own = [int(scene.object(3).color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    assert torch.allclose(ids[3].tints, torch.tensor([*own, 0.75]))


def test_what_an_edit_changes_is_drawn_anew_and_nothing_else(scene: Scene):
    before = parts_of(Shown(scene))
    moved = scene.move(3, (0.0, 0.1, 0.0))
    after = parts_of(Shown(moved))
    alike = {n: drawn_alike(scene, moved, before[n], after[n]) for n in after}
    assert alike == {0: True, 1: True, 3: False}
    chosen = parts_of(Shown(scene, frozenset({1})))
    assert not drawn_alike(scene, scene, before[1], chosen[1])
    merged = scene.merge(1, 3)
    assert not drawn_alike(scene, merged, before[1], parts_of(Shown(merged))[1])
