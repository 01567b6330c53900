"""PLYs as other programs write them: byte orders, ASCII, more elements, columns of groups."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from instok3d.formats.ply import read_ply, write_ply
from instok3d.formats.ply_tables import read_header, read_table
from instok3d.scene.scene import Scene
from instok3d.types import Gaussians


def table_of(path: Path) -> np.ndarray:
    header = read_header(path)
    return read_table(path, header, header.elements[0])


def write_variant(path: Path, rows: np.ndarray, encoding: str, behind: bytes = b"") -> None:
    """A PLY of the rows in another encoding."""
    names = rows.dtype.names or ()
    lines = ["ply", f"format {encoding} 1.0", "comment Vertical axis: 0 0 2",
             f"element vertex {len(rows)}"]  # fmt: skip
    lines += [f"property float {name}" for name in names]
    if behind:
        lines += ["element extrinsic 2", "property double value"]
    values = np.stack([rows[name] for name in names], axis=1).astype(np.float32)
    if encoding == "ascii":
        body = "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in values).encode()
    else:
        body = values.astype("<f4" if "little" in encoding else ">f4").tobytes()
    path.write_bytes(("\n".join([*lines, "end_header"]) + "\n").encode() + body + behind)


def assert_same(first: Gaussians, second: Gaussians) -> None:
    for name, value in vars(first).items():
        torch.testing.assert_close(getattr(second, name), value, msg=name)


@pytest.mark.parametrize("encoding", ["binary_little_endian", "binary_big_endian", "ascii"])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_encodings_hold_the_same(tmp_path: Path, scene: Scene, encoding: str, degree: int):
    write_ply(tmp_path / "a.ply", scene.gaussians, sh_degree=degree)
    write_variant(tmp_path / "b.ply", table_of(tmp_path / "a.ply"), encoding)
    again = read_ply(tmp_path / "b.ply")
    assert again.gaussians.sh.shape[1] == (degree + 1) ** 2
    assert again.up == (0, 0, 1)
    assert_same(read_ply(tmp_path / "a.ply").gaussians, again.gaussians)


def test_elements_behind_the_gaussians_are_left_alone(tmp_path: Path, scene: Scene):
    # SHARP, for example, appends its camera.
    write_ply(tmp_path / "a.ply", scene.gaussians)
    rows = table_of(tmp_path / "a.ply")
    write_variant(tmp_path / "b.ply", rows, "binary_little_endian", behind=bytes(16))
    assert_same(read_ply(tmp_path / "a.ply").gaussians, read_ply(tmp_path / "b.ply").gaussians)
    write_variant(tmp_path / "b.ply", rows, "binary_little_endian", behind=bytes(15))
    with pytest.raises(ValueError, match="cut short or damaged"):
        read_ply(tmp_path / "b.ply")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda text: text[: len(text) // 2], "promises"),
        (lambda text: text.replace(b"\n", b"\nx ", 30), "damaged"),
        (lambda text: text[:-4] + b" 7 7\n", "damaged"),
        (lambda text: text[:-2] + b"\xff\n", "damaged"),
    ],
)
def test_damaged_ascii_is_refused(tmp_path: Path, scene: Scene, damage, message: str):
    write_ply(tmp_path / "a.ply", scene.gaussians, sh_degree=0)
    write_variant(tmp_path / "b.ply", table_of(tmp_path / "a.ply"), "ascii")
    whole = (tmp_path / "b.ply").read_bytes()
    start = whole.index(b"end_header\n") + 11
    (tmp_path / "b.ply").write_bytes(whole[:start] + damage(whole[start:]))
    with pytest.raises(ValueError, match=rf"b\.ply.*{message}"):
        read_ply(tmp_path / "b.ply")


def with_columns(rows: np.ndarray, more: dict[str, np.ndarray]) -> np.ndarray:
    names = rows.dtype.names or ()
    wide = np.zeros(len(rows), [(name, "<f4") for name in (*names, *more)])
    for name in names:
        wide[name] = rows[name]
    for name, values in more.items():
        wide[name] = values
    return wide


@pytest.mark.parametrize("name", ["object_id", "label", "ins_id"])
def test_a_column_of_ids_tells_the_groups(tmp_path: Path, scene: Scene, name: str):
    write_ply(tmp_path / "a.ply", scene.gaussians)
    ids = scene.object_ids().numpy()
    rows = with_columns(table_of(tmp_path / "a.ply"), {name: np.where(ids == 0, -1, ids)})
    write_variant(tmp_path / "b.ply", rows, "binary_little_endian")
    assert torch.equal(read_ply(tmp_path / "b.ply").object_ids, scene.object_ids())
    rows[name][2] = np.nan
    write_variant(tmp_path / "b.ply", rows, "binary_little_endian")
    with pytest.raises(ValueError, match=f"the column {name} holds 1 values that are no whole"):
        read_ply(tmp_path / "b.ply")


def test_ids_stay_with_their_gaussians_when_some_are_dropped(tmp_path: Path, scene: Scene):
    means = scene.gaussians.means.clone()
    means[3] = torch.nan
    write_ply(tmp_path / "a.ply", replace(scene.gaussians, means=means),
              object_ids=scene.object_ids())  # fmt: skip
    kept = [index for index in range(len(means)) if index != 3]
    assert torch.equal(read_ply(tmp_path / "a.ply").object_ids, scene.object_ids()[kept])


def test_gaussian_groupings_classifier_turns_features_into_groups(tmp_path: Path, scene: Scene):
    write_ply(tmp_path / "a.ply", scene.gaussians)
    ids = scene.object_ids() % 4
    features = torch.nn.functional.one_hot(ids, 4).float() @ torch.randn(
        4, 16, generator=torch.Generator().manual_seed(0)
    )
    more = {f"obj_dc_{i}": features[:, i].numpy() for i in range(16)}
    write_variant(tmp_path / "b.ply", with_columns(table_of(tmp_path / "a.ply"), more),
                  "binary_little_endian")  # fmt: skip
    without = read_ply(tmp_path / "b.ply")
    assert not without.object_ids.any()
    assert "no classifier.pth lies beside it" in without.notes[0]
    # Scores are the features' own products with each class's feature: the largest is its own.
    basis = torch.nn.functional.one_hot(torch.arange(4)).float() @ torch.randn(
        4, 16, generator=torch.Generator().manual_seed(0)
    )
    state = {"weight": basis[:, :, None, None], "bias": -0.5 * basis.square().sum(dim=1)}
    torch.save(state, tmp_path / "classifier.pth")
    assert torch.equal(read_ply(tmp_path / "b.ply").object_ids, ids)
    torch.save({**state, "bias": torch.zeros(3)}, tmp_path / "classifier.pth")
    with pytest.raises(ValueError, match=r"classifier\.pth is damaged .its bias is .3,., wanted"):
        read_ply(tmp_path / "b.ply")
