import math
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from instok3d.formats.ply import read_ply, write_ply
from instok3d.render import render
from instok3d.scene.scene import Scene
from instok3d.types import MAX_LENGTH, Gaussians, check_gaussians
from made_scene import made_scene, made_tokens
from splat_scenes import psnr


def one_gaussian() -> Gaussians:
    return Gaussians(
        means=torch.tensor([[1.0, 2.0, 3.0]]),
        quats=torch.tensor([[0.5, -0.5, 0.5, -0.5]]),
        scales=torch.tensor([[1.0, math.e, math.e**2]]),
        opacities=torch.tensor([0.5]),
        sh=torch.arange(12.0).view(1, 4, 3),
        anchor_index=torch.tensor([0]),
    )


def test_bytes_of_one_gaussian_by_hand(tmp_path: Path):
    write_ply(tmp_path / "a.ply", one_gaussian(), sh_degree=1, comments=("made by hand",))
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\ncomment made by hand\n")
    # Position, normal 0, f_dc = coefficient 0, f_rest = coefficients 1..3 of red (3, 6, 9), then
    # green and blue, logit(1/2) = 0, log scales 0, 1, 2, quaternion wxyz.
    numbers = [1, 2, 3, 0, 0, 0, 0, 1, 2, 3, 6, 9, 4, 7, 10, 5, 8, 11, 0, 0, 1, 2,
               0.5, -0.5, 0.5, -0.5]  # fmt: skip
    assert struct.unpack(f"<{len(numbers)}f", body) == pytest.approx(numbers, abs=1e-6)


@pytest.mark.parametrize("sh_count", [1, 4, 9, 16])
def test_what_was_written_is_read_again(tmp_path: Path, sh_count: int):
    gaussians = made_scene(made_tokens(sh_count=sh_count)).gaussians
    write_ply(tmp_path / "a.ply", gaussians)
    again = read_ply(tmp_path / "a.ply").gaussians
    assert again.sh.shape[1] == 16
    torch.testing.assert_close(again.sh[:, :sh_count], gaussians.sh)
    assert not again.sh[:, sh_count:].any()
    for name in ("means", "quats", "scales", "opacities"):
        torch.testing.assert_close(getattr(again, name), getattr(gaussians, name))


def test_export_import_renders_the_same_picture(tmp_path: Path, scene: Scene):
    write_ply(tmp_path / "a.ply", scene.gaussians)
    again = read_ply(tmp_path / "a.ply").gaussians
    picture = render(again, scene.cameras, scene.height, scene.width).colors
    assert psnr(picture, scene.render().colors) >= 60


def test_ids_are_the_last_column_and_change_nothing_else(tmp_path: Path, scene: Scene):
    write_ply(tmp_path / "a.ply", scene.gaussians, object_ids=scene.object_ids())
    write_ply(tmp_path / "b.ply", scene.gaussians)
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    assert header.endswith(b"property float object_id\n")
    rows = np.frombuffer(body, "<f4").reshape(len(scene.gaussians.means), -1)
    assert rows[:, -1].tolist() == scene.object_ids().tolist()
    first, second = read_ply(tmp_path / "a.ply").gaussians, read_ply(tmp_path / "b.ply").gaussians
    assert all(torch.equal(a, b) for a, b in zip(vars(first).values(), vars(second).values(),
                                                 strict=True))  # fmt: skip


def test_opacities_of_exactly_0_and_1_stay_finite(tmp_path: Path):
    both = made_scene(made_tokens()).gaussians
    opacities = torch.zeros_like(both.opacities)
    opacities[::2] = 1
    write_ply(tmp_path / "a.ply", replace(both, opacities=opacities))
    torch.testing.assert_close(
        read_ply(tmp_path / "a.ply").gaussians.opacities, opacities, atol=2e-6, rtol=0
    )


def rows_of(file: Path) -> np.ndarray:
    """The numbers of a PLY of floats alone, to be changed in place."""
    header, _ = file.read_bytes().split(b"end_header\n")
    names = [line.split()[2].decode() for line in header.splitlines() if b"property" in line]
    return np.memmap(file, [(n, "<f4") for n in names], "r+", offset=len(header) + 11)


def test_full_opacity_and_flat_gaussians_of_others_are_kept(tmp_path: Path):
    # A logit of +-inf and a logarithm of -inf are what others write for 1, 0 and a scale of 0.
    gaussians = made_scene(made_tokens()).gaussians
    write_ply(tmp_path / "a.ply", gaussians)
    rows = rows_of(tmp_path / "a.ply")
    rows["opacity"][:2] = np.inf, -np.inf
    rows["scale_2"][0] = -np.inf
    rows.flush()
    again = read_ply(tmp_path / "a.ply").gaussians
    check_gaussians(again, "a.ply")
    assert len(again.means) == len(gaussians.means)
    assert again.opacities[0] == 1
    assert 0 <= again.opacities[1] < 1e-30
    assert 0 < again.scales[0, 2] < 1e-30
    write_ply(tmp_path / "b.ply", again)
    opacities = read_ply(tmp_path / "b.ply").gaussians.opacities
    torch.testing.assert_close(opacities[:2], torch.tensor([1.0, 0]), atol=2e-6, rtol=0)


def test_whatever_can_be_drawn_comes_back(tmp_path: Path):
    tiny = torch.finfo(torch.float32).tiny
    scales = torch.tensor([tiny, 1e-20, 1e-9, 1.0, 1e5, MAX_LENGTH])
    gaussians = Gaussians(
        means=torch.tensor([[-MAX_LENGTH, 0.0, MAX_LENGTH]]).expand(6, 3).contiguous(),
        quats=torch.tensor([[0.0, 0, 0, -1]]).expand(6, 4).contiguous(),
        scales=scales[:, None].expand(6, 3).contiguous(),
        opacities=torch.tensor([0.0, 1e-6, 0.5, 0.999, 1 - 1e-6, 1.0]),
        sh=torch.tensor([-1e30, 1e30]).view(1, 1, 2)[:, :, [0, 1, 0]].repeat(6, 1, 1),
        anchor_index=torch.zeros(6, dtype=torch.long),
    )
    check_gaussians(gaussians, "made by hand")
    write_ply(tmp_path / "a.ply", gaussians, sh_degree=0)
    again = read_ply(tmp_path / "a.ply").gaussians
    check_gaussians(again, "a.ply")
    for name in ("means", "quats", "sh"):
        assert torch.equal(getattr(again, name), getattr(gaussians, name)), name
    # The logarithm of the smallest has 5 digits before its point and 3e-6 behind the last one.
    torch.testing.assert_close(again.scales, gaussians.scales, rtol=1e-5, atol=0)
    torch.testing.assert_close(again.opacities, gaussians.opacities, rtol=0, atol=2e-6)


def test_quaternions_of_any_length_but_0_are_rotations(tmp_path: Path):
    gaussians = made_scene(made_tokens()).gaussians
    write_ply(tmp_path / "a.ply", gaussians)
    rows = rows_of(tmp_path / "a.ply")
    for row, factor in enumerate((1e-30, 1e30, 3.0, 0.0)):
        for i in range(4):
            rows[f"rot_{i}"][row] *= factor
    rows.flush()
    splats = read_ply(tmp_path / "a.ply")
    again = splats.gaussians
    assert re.search("dropped 1 Gaussians .* a quaternion of length 0", splats.notes[0])
    torch.testing.assert_close(again.quats[:3], gaussians.quats[:3])
    check_gaussians(again, "a.ply")


def test_doubles_beyond_single_precision_are_dropped_and_counted(tmp_path: Path):
    write_ply(tmp_path / "a.ply", one_gaussian(), sh_degree=0)
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    numbers = np.frombuffer(body, "<f4").astype("<f8")
    numbers[0] = 1e300
    (tmp_path / "a.ply").write_bytes(
        header.replace(b"property float", b"property double") + b"end_header\n" + numbers.tobytes()
    )
    splats = read_ply(tmp_path / "a.ply")
    assert len(splats.gaussians.means) == 0
    assert len(splats.notes) == 1
    assert "dropped 1 Gaussians" in splats.notes[0]


def test_no_gaussians_make_a_file_too(tmp_path: Path):
    empty = Gaussians(**{name: value[:0] for name, value in vars(one_gaussian()).items()})
    write_ply(tmp_path / "a.ply", empty)
    assert read_ply(tmp_path / "a.ply").gaussians.means.shape == (0, 3)


def test_rows_that_are_not_finite_are_dropped_and_counted(tmp_path: Path):
    gaussians = made_scene(made_tokens()).gaussians
    means = gaussians.means.clone()
    means[3, 1] = torch.inf
    write_ply(tmp_path / "a.ply", replace(gaussians, means=means))
    splats = read_ply(tmp_path / "a.ply")
    assert "dropped 1 Gaussians" in splats.notes[0]
    assert len(splats.gaussians.means) == len(gaussians.means) - 1


def test_damaged_files_are_refused_before_anything_is_allocated(tmp_path: Path):
    file = tmp_path / "a.ply"
    write_ply(file, one_gaussian())
    whole = file.read_bytes()
    cases = {
        "it is cut short": whole[:-1],
        "cut short or damaged": whole + b"x",
        "promises rows .999999999999 of 'vertex'": whole.replace(
            b"vertex 1\n", b"vertex 999999999999\n"
        ),
        "found format binary 1.0": whole.replace(b"binary_little_endian", b"binary"),
        "missing columns .'opacity'.": whole.replace(
            b"property float opacity\n", b"property float density\n"
        ),
        "missing columns .'f_rest_0'.": whole.replace(b"f_rest_0\n", b"f_rest_99\n"),
        "doubled columns in the element 'vertex'": whole.replace(b"f_rest_0\n", b"f_rest_1\n"),
        "cannot read the line 'element vertex 9999": whole.replace(
            b"vertex 1\n", b"vertex " + b"9" * 5000 + b"\n"
        ),
        "cannot read the line 'element'": whole.replace(b"element vertex 1\n", b"element\n"),
        "missing columns": whole.replace(b"float opacity\n", b"list uchar int a\n"),
        "wanted the element 'vertex', found: points": whole.replace(b"vertex", b"points"),
        "cannot read the property 'property half": whole.replace(b"float opacity", b"half opacity"),
        "no header found": b"\x89PNG\r\n",
        "no header found in": b"ply\n" + b"comment x\n" * 50_000,
    }
    for message, content in cases.items():
        file.write_bytes(content)
        with pytest.raises(ValueError, match=message):
            read_ply(file)
