"""Our files in viser, a viewer that draws with its own shaders what stands in their bytes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from browser import PATIENCE_MS, browser
from instok3d.formats.registry import export_scene, read_splats
from instok3d.geometry.cameras import invert_rigid
from instok3d.geometry.rotations import matrix_to_quat
from splat_scenes import SIDE, camera, corner_scene, picture, psnr

RECORD = np.dtype([("center", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
"""Of a .splat file, as its format has it; no reader of ours takes part."""
STAND, FOV_RAD = (0.7, -0.4, 0.0), 2 * np.arctan(0.5)


def test_viser_draws_the_coloured_corners_of_a_file_as_we_do(tmp_path: Path):
    viser = pytest.importorskip("viser", reason="needs viser: '.[view]'")
    path = tmp_path / "a.splat"
    export_scene(corner_scene(), path)
    rows = np.frombuffer(path.read_bytes(), RECORD)
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    # Splats are drawn by the projection of the page's own last frame, whatever get_render is asked
    # for: so the page gets the shape and the field of view of our picture.
    page = browser().new_page(viewport={"width": 2 * SIDE, "height": 2 * SIDE})
    page.set_default_timeout(PATIENCE_MS)
    try:
        server.scene.add_gaussian_splats(
            "/corners", centers=rows["center"], rgbs=rows["rgba"][:, :3] / 255.0,
            opacities=rows["rgba"][:, 3:] / 255.0, covariances=covariances(rows),
        )  # fmt: skip
        address = f"http://127.0.0.1:{server.get_port()}"
        page.goto(f"{address}/?fixedDpr=1&initialCameraFov={FOV_RAD:.6f}")
        while not server.get_clients():
            page.wait_for_timeout(50)
        drawn = seen(page, next(iter(server.get_clients().values())))
    finally:
        page.close()
        server.stop()
    ours = picture(read_splats(path).gaussians, STAND)
    assert psnr(drawn, ours) > 45
    for other in (drawn.flip(2), drawn.flip(1), drawn.flip(0), drawn.mT):
        assert psnr(other, ours) < 25


def covariances(rows: np.ndarray) -> np.ndarray:
    """R S S^T R^T of the records; quaternions are wxyz, 128 is 0."""
    w, x, y, z = ((rows["quat"].astype(float) - 128) / 128).T
    turn = np.stack([
        w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z,
    ], axis=1).reshape(-1, 3, 3)  # fmt: skip
    turn /= (w * w + x * x + y * y + z * z)[:, None, None]
    stretched = turn * rows["scale"][:, None, :]
    return stretched @ stretched.transpose(0, 2, 1)


def seen(page: Any, client: Any) -> torch.Tensor:
    """The picture from STAND on black, once it no longer changes: splats come and are sorted."""
    pose = invert_rigid(camera(STAND).cam_from_world)[0]
    before = torch.zeros(3, SIDE, SIDE)
    for _ in range(100):
        rendered = client.get_render(
            SIDE, SIDE, wxyz=matrix_to_quat(pose[:3, :3]).numpy(), position=pose[:3, 3].numpy(),
            fov=FOV_RAD, transport_format="png", timeout=PATIENCE_MS / 1000,
        )  # fmt: skip
        rgba = torch.from_numpy(rendered.copy()).permute(2, 0, 1) / 255
        colors = rgba[:3] * rgba[3:]
        if colors.max() > 0.3 and torch.equal(colors, before):
            return colors
        before = colors
        page.wait_for_timeout(100)
    pytest.fail("viser never drew the splats")
