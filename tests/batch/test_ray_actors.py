"""Batches on a Ray of this machine, with workers that are killed."""

import json
import socket
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from dying_scenes import dying_scene
from instok3d.batch.ray_actors import ray_actors, shared_processors
from instok3d.cli import main
from instok3d.scene.reconstruct import reconstruct
from instok3d.scene.scene import Scene
from made_model import made_model, made_photos


@pytest.mark.slow
def test_a_scene_whose_worker_is_killed_is_taken_up_by_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    pytest.importorskip("ray", reason="needs ray: '.[ray]'")
    for name in ("bath", "cursed", "kitchen"):
        (tmp_path / "photos").mkdir(exist_ok=True)
        made_photos(tmp_path / "photos" / name)
    (tmp_path / "photos" / "broken").mkdir()
    (tmp_path / "photos" / "broken" / "a.png").write_text("no picture")
    model = made_model(tmp_path / "model.safetensors")
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
    monkeypatch.setattr("instok3d.batch.run.timed_scene", dying_scene)
    monkeypatch.chdir(tmp_path)
    words = ["batch", "photos", "-o", "out", "--model", model.name, "--refine", "0", "--json"]

    assert main([*words, "--ray", "local", "--workers", "2"]) == 2
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert (found["made"], found["done"], found["failed"]) == (4, 2, 2)
    errors = {name: each["error"] for name, each in found["scenes"].items() if each["error"]}
    assert sorted(errors) == ["broken", "cursed"]
    assert errors["cursed"] == "its process was killed: too little memory?"
    assert "a.png" in errors["broken"]
    assert "Traceback" not in said.err
    # Both were killed while half of the scene lay there; nothing of it is left.
    for name in ("bath", "cursed"):
        assert (tmp_path / "marks" / f"{name} began").read_text().startswith(".instok3d-")
    made = ("bath.itk", "kitchen.itk", "batch.json", "contact_sheet.jpg")
    assert sorted(each.name for each in (tmp_path / "out").iterdir()) == sorted(made)
    alone = reconstruct(tmp_path / "photos" / "bath", model=model, refine=0)
    for name in ("bath", "kitchen"):
        assert found["scenes"][name]["seconds"] == 1  # models that its process had read
        scene = Scene.load(tmp_path / "out" / f"{name}.itk")
        assert scene.provenance == alone.provenance
        # Another process may add up in another order.
        torch.testing.assert_close(scene.gaussians.means, alone.gaussians.means)

    monkeypatch.undo()  # without Ray the same batch goes on
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    found = json.loads(capsys.readouterr().out)
    assert (found["made"], found["done"], found["failed"]) == (2, 3, 1)


@pytest.mark.parametrize(
    ("machines", "workers", "processors"),
    [([2], 2, 1), ([8], 3, 2), ([6, 6], 2, 6), ([6, 6], 3, 3), ([16, 4], 3, 5), ([4, 0], 1, 4)],
)
def test_workers_share_processors_evenly_and_none_is_split(
    machines: list[int], workers: int, processors: int
):
    assert shared_processors(machines, workers) == processors


def test_more_workers_than_processors_are_refused():
    with pytest.raises(ValueError, match="has 5 processors, too few for 6 workers"):
        shared_processors([4, 1], 6)
    with pytest.raises(ValueError, match="has 0 processors, too few for 1 workers"):
        shared_processors([], 1)


@pytest.mark.parametrize("address", ["zebra", "ray://head:10001", "head:0", "head:70000", ""])
def test_what_is_no_address_is_refused(address: str):
    with (
        pytest.raises(ValueError, match=r"--ray takes HOST:PORT, auto or local, got"),
        ray_actors(address),
    ):
        pass


def test_where_nothing_answers_it_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    words = ["batch", str(tmp_path), "-o", str(tmp_path / "out"), "--ray", address]
    assert main(words) == 2
    assert f"no Ray cluster answers at {address} (Connection refused)" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_without_ray_it_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with (
        pytest.raises(ModuleNotFoundError, match=r"pip install 'instok3d\[ray\]'"),
        ray_actors("local"),
    ):
        pass
    with (
        pytest.raises(ValueError, match="workers must be 1 or more, got 0"),
        ray_actors("local", 0),
    ):
        pass


def test_a_cluster_that_does_not_start_is_no_fault_of_the_program(monkeypatch: pytest.MonkeyPatch):
    def init(*words: object, **settings: object) -> None:
        raise Exception("The current node timed out\nduring startup.")  # as Ray does

    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(init=init))
    with (
        pytest.raises(ConnectionError, match="cluster local: The current node timed out during"),
        ray_actors("local"),
    ):
        pass
