"""The denoiser, and rooms without it."""

import sys

import numpy as np
import pytest

pytest.importorskip("embreex")

from instok3d.rooms.camera_path import intrinsics_of, looking
from instok3d.rooms.denoising import Denoiser, find_denoiser
from instok3d.rooms.rendering import Renderer
from instok3d.rooms.room import build_room
from instok3d.rooms.seeding import Streams
from instok3d.rooms.sensor import developed


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(((a / 255.0 - b / 255.0) ** 2).mean()))


def test_a_missing_denoiser_is_warned_of(monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba_oidn", None)
    with pytest.warns(UserWarning, match=r"mitsuba-oidn is not installed.*instok3d\[rooms\]"):
        assert find_denoiser() is None


def test_pictures_with_and_without_the_denoiser_are_close():
    pytest.importorskip("mitsuba_oidn")
    room = build_room(3, "medium")
    eye = np.array([room.plan.width / 2, room.plan.depth / 2, 1.5])
    view = intrinsics_of(64, 60.0), looking(eye, 0.5, -0.2, 0.0), 64, 64
    renderer = Renderer(room, Streams(3).child("lights"), None)
    plain = [renderer.render(*view, np.random.default_rng(i)) for i in range(8)]
    renderer.denoiser = Denoiser()
    clean = renderer.render(*view, np.random.default_rng(0))
    np.testing.assert_array_equal(plain[0].instances, clean.instances)
    np.testing.assert_array_equal(plain[0].depth_m, clean.depth_m)

    # Seven pictures of 16 samples a pixel are the truth; measured: 22.2 dB from the eighth and
    # 26.4 dB from the denoised one, whose 4 samples a pixel would have about 16 dB alone.
    truth = np.mean([frame.radiance for frame in plain[1:]], axis=0)
    assert clean.radiance.mean() == pytest.approx(truth.mean(), rel=0.04)
    noisy, smooth, true = (
        developed(radiance, 1.0) for radiance in (plain[0].radiance, clean.radiance, truth)
    )
    assert psnr(noisy, true) > 20
    assert psnr(smooth, true) > psnr(noisy, true) + 2
