import errno
import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import instok3d
from instok3d.cli import exit_code, main
from instok3d.formats.ply import read_ply
from instok3d.scene.scene import Scene
from made_model import made_model, made_photos
from made_scene import made_scene, made_tokens


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(made_model(tmp_path_factory.mktemp("model") / "random.safetensors"))


@pytest.fixture
def room(tmp_path: Path) -> str:
    made_scene(made_tokens()).save(tmp_path / "room.itk")
    return str(tmp_path / "room.itk")


def test_unknown_commands_and_options_are_bad_input(capsys: pytest.CaptureFixture[str]):
    assert main(["paint"]) == 2
    assert "no command 'paint'" in capsys.readouterr().err
    assert main(["info", "--nonsense"]) == 2
    assert main([]) == 2
    assert main(["data", "paint"]) == 2
    assert "instok3d data: no command 'paint'" in capsys.readouterr().err
    assert main(["data", "verify", "--nonsense"]) == 2
    assert main(["data"]) == 2


def test_photos_become_a_scene(
    tmp_path: Path, model: str, capsys: pytest.CaptureFixture[str]
):  # fmt: skip
    photos = made_photos(tmp_path / "photos")
    output = tmp_path / "room.itk"
    words = ["reconstruct", str(photos), "-o", str(output), "--model", model, "--timings"]
    assert main(words) == 0
    shown = capsys.readouterr()
    assert f"written to {output}" in shown.out
    for stage in ("photos", "model", "geometry", "tokens", "objects", "previews", "save"):
        assert stage in shown.err
    scene = instok3d.load(output)
    assert (scene.height, scene.width) == (32, 32)
    assert [view.file for view in scene.views] == ["0.png", "1.png"]
    assert scene.provenance.model == "random"
    assert (scene.frame, scene.units) == ("first camera", "arbitrary")


def test_same_photos_and_seed_give_the_same_bytes(tmp_path: Path, model: str):
    photos = made_photos(tmp_path / "photos", 4)
    for name in ("a.itk", "b.itk"):
        assert main(["reconstruct", str(photos), "-o", str(tmp_path / name), "--model", model]) == 0
    first, second = (
        {file.name: file.read_bytes() for file in (tmp_path / name).rglob("*") if file.is_file()}
        for name in ("a.itk", "b.itk")
    )
    assert first == second


def test_json_is_one_object_on_stdout(tmp_path: Path, model: str, capsys: pytest.CaptureFixture):
    photos = made_photos(tmp_path / "photos")
    output = str(tmp_path / "room.itk")
    assert main(["reconstruct", str(photos), "-o", output, "--model", model, "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["scene"] == output
    assert set(made["timings_s"]) >= {"photos", "geometry", "tokens", "save"}
    assert main(["info", output, "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert {name: made[name] for name in info} == info


def test_given_cameras_make_the_world(tmp_path: Path, model: str):
    photos = made_photos(tmp_path / "photos")
    world_from_cam = torch.eye(4)
    world_from_cam[:3, 3] = torch.tensor([5.0, 6, 7])
    frames = []
    for index in range(2):
        world_from_cam[0, 3] += 0.2 * index
        frames.append({"id": str(index), "color": f"{index}.png", "c2w": world_from_cam.tolist()})
    cameras = {"width": 60, "height": 40, "K": [[50, 0, 30], [0, 50, 20], [0, 0, 1]],
               "convention": "c2w, OpenCV axes, metres", "frames": frames}  # fmt: skip
    (photos / "scene.json").write_text(json.dumps(cameras))
    output = tmp_path / "room.itk"
    words = ["reconstruct", str(photos), "-o", str(output), "--model", model]
    assert main([*words, "--cameras", str(photos / "scene.json")]) == 0
    scene = instok3d.load(output)
    assert (scene.frame, scene.units) == ("given cameras", "metres")
    torch.testing.assert_close(
        scene.cameras.cam_from_world[:, :3, 3], torch.tensor([[-5.0, -6, -7], [-5.2, -6, -7]])
    )
    # The Gaussians lie in front of the cameras, which look along z from z = 7.
    assert float(scene.gaussians.means[:, 2].median()) > 7


BAD_INPUTS = {
    "there is no file or folder": lambda folder: folder / "nowhere",
    "holds no photo": lambda folder: folder,
    "": lambda folder: (folder / "text.png").write_text("not a picture") and folder,
}


@pytest.mark.parametrize("message", BAD_INPUTS)
def test_bad_photos_are_bad_input_and_leave_nothing(
    tmp_path: Path, model: str, capsys: pytest.CaptureFixture[str], message: str
):
    (tmp_path / "in").mkdir()
    source = str(BAD_INPUTS[message](tmp_path / "in"))
    assert main(["reconstruct", source, "-o", str(tmp_path / "out.itk"), "--model", model]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("instok3d: ")
    assert message in error
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_a_scene_that_is_there_is_kept_before_any_work(
    room: str, model: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    photos = made_photos(tmp_path / "photos")
    before = instok3d.load(room).objects
    words = ["reconstruct", str(photos), "-o", room, "--model", model]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "pass --overwrite" in error
    assert "geometry" not in error
    assert instok3d.load(room).objects == before
    assert main([*words, "--overwrite"]) == 0
    assert instok3d.load(room).provenance.model == "random"


def test_missing_weights_have_their_own_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    photos = made_photos(tmp_path / "photos")
    words = ["reconstruct", str(photos), "-o", str(tmp_path / "a.itk"), "--model", "nowhere.st"]
    assert main(words) == 4
    assert "nowhere.st" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), 3),
        (MemoryError(), 3),
        (KeyboardInterrupt(), 130),
        (PermissionError(errno.EACCES, "Permission denied", "x"), 2),
        (RuntimeError("a fault"), 1),
    ],
)
def test_errors_while_saving_have_their_codes_and_leave_nothing(
    tmp_path: Path,
    model: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
):
    def fail(*arguments: object, **options: object) -> None:
        raise error

    monkeypatch.setattr("instok3d.scene.previews.write_previews", fail)
    photos = made_photos(tmp_path / "photos")
    output = tmp_path / "a.itk"
    assert main(["reconstruct", str(photos), "-o", str(output), "--model", model]) == code
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]
    shown = capsys.readouterr()
    assert "instok3d: " in shown.err
    assert ("Traceback" in shown.err) == (code == 1)
    assert shown.out == ""


def test_options_that_cannot_be_are_bad_input(
    tmp_path: Path, model: str, capsys: pytest.CaptureFixture[str]
):
    photos = str(made_photos(tmp_path / "photos"))
    words = ["reconstruct", photos, "-o", str(tmp_path / "a.itk"), "--model", model]
    cases = {("--device", "abacus"): "none that torch knows", ("--seed", "-1"): "seed must lie",
             ("--max-views", "0"): "at least one view", ("--pixels", "1000"): "must lie in 64..512",
             ("--pixels", "100"): "must be a multiple of the 8 pixels"}  # fmt: skip
    if not torch.cuda.is_available():
        cases[("--device", "cuda")] = "no CUDA device"
    for options, message in cases.items():
        assert main([*words, *options]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "stage", "code"),
    [("SIGINT", "photos", 130), ("SIGTERM", "previews", 143), ("SIGHUP", "previews", 129)],
)
def test_a_signal_stops_with_its_code_and_leaves_nothing(
    tmp_path: Path, model: str, name: str, stage: str, code: int
):
    number = getattr(signal, name)
    photos = str(made_photos(tmp_path / "photos"))
    words = ["reconstruct", photos, "-o", str(tmp_path / "a.itk"), "--model", model]

    def listen() -> None:
        # A shell starts its background jobs, and CI perhaps all of this, with Ctrl-C ignored.
        signal.signal(number, signal.SIG_DFL)

    with subprocess.Popen([sys.executable, "-m", "instok3d", *words], stderr=subprocess.PIPE,
                          text=True, preexec_fn=listen) as process:  # fmt: skip
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith(stage):
                process.send_signal(number)
                break
        rest = process.stderr.read()
    assert process.returncode == code
    assert f"instok3d: {'interrupted' if code == 130 else f'ended by {name}'}" in rest
    assert "Traceback" not in rest
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]


def test_only_the_first_signal_is_heard_and_an_ignored_one_never():
    code = (
        "import os, signal, sys, instok3d.cli as cli\n"
        "def work(words):\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGHUP)\n"  # as under nohup
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "    finally:\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "        print('cleared away')\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "cli._dispatch = work\n"
        "sys.exit(cli.main([]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 143
    assert done.stdout == "cleared away\n"
    assert done.stderr == "\ninstok3d: ended by SIGTERM; nothing half-written was left\n"


def test_ctrl_c_within_an_exec_ends_with_the_exit_code():
    # Dataclasses and named tuples are made by exec, so that any import may be within one.
    code = (
        "import sys, instok3d.cli as cli\n"
        "cli._dispatch = lambda words: exec('import signal; signal.raise_signal(signal.SIGINT)')\n"
        "sys.exit(cli.main([]))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 130


def test_a_folder_brings_its_own_cameras(tmp_path: Path, model: str):
    color = tmp_path / "capture" / "color"
    color.parent.mkdir()
    made_photos(color)
    frames = [
        {"color": f"color/{photo.name}", "c2w": np.eye(4).tolist()}
        for photo in sorted(color.iterdir())
    ]
    frames[1]["c2w"][0][3] = 0.5
    with Image.open(next(color.iterdir())) as photo:
        width, height = photo.size
    intrinsics = [[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]]
    table = {"width": width, "height": height, "K": intrinsics, "frames": frames}
    (color.parent / "scene.json").write_text(json.dumps(table))
    output = tmp_path / "room.itk"
    assert main(["reconstruct", str(color.parent), "-o", str(output), "--model", model]) == 0
    scene = instok3d.load(output)
    assert (scene.units, scene.frame) == ("metres", "given cameras")
    assert scene.cameras.cam_from_world[1, 0, 3] == -0.5


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]):
    assert main(["info", "nowhere.itk", "--debug"]) == 2
    assert "Traceback" in capsys.readouterr().err
    assert exit_code(RuntimeError("DefaultCPUAllocator: can't allocate memory")) == 3


def test_info_tells_the_objects(room: str, capsys: pytest.CaptureFixture[str]):
    assert main(["info", room]) == 0
    shown = capsys.readouterr().out
    assert "2 views of 24 x 32, 2 objects, 40 Gaussians (20 of them of objects)" in shown
    assert "object#3" in shown
    assert "world: first camera, x right, y down, z forward; -y is up within 15 degrees" in shown


def test_info_tells_which_way_is_up_in_a_world_of_given_cameras(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    # x right, z down, y forward, then turned by 90 degrees to the left: z is up.
    down = [0.0, 0.0, -1.0]
    rotations = torch.tensor([[[1.0, 0, 0], down, [0, 1, 0]], [[0, 1, 0], down, [-1, 0, 0]]])
    cameras = torch.eye(4).repeat(2, 1, 1)
    cameras[:, :3, :3] = rotations
    made_scene(made_tokens(), cam_from_world=cameras).save(tmp_path / "room.itk")
    assert main(["info", str(tmp_path / "room.itk")]) == 0
    shown = capsys.readouterr().out
    assert "up is (0, 0, 1) by how they are turned" in shown
    assert "y down" not in shown
    assert main(["info", str(tmp_path / "room.itk"), "--json"]) == 0
    vertical = json.loads(capsys.readouterr().out)["vertical"]
    assert (vertical["up"], vertical["source"]) == ([0, 0, 1], "given cameras")


def test_render_writes_a_folder_with_ids(room: str, tmp_path: Path):
    folder = tmp_path / "pictures"
    assert main(["render", room, "-o", str(folder), "--ids"]) == 0
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["000.png", "000_ids.png", "001.png", "001_ids.png"]
    with Image.open(folder / "000_ids.png") as ids:
        assert set(np.unique(np.array(ids)).tolist()) == {0, 1, 3}
    assert main(["render", room, "-o", str(folder)]) == 2
    assert main(["render", room, "-o", str(folder), "--overwrite"]) == 0


def test_render_writes_a_strip_of_an_orbit_at_any_size(room: str, tmp_path: Path):
    strip = tmp_path / "strip.png"
    words = ["render", room, "-o", str(strip), "--path", "orbit", "--frames", "3"]
    assert main([*words, "--height", "12", "--width", "16", "--only", "object#1"]) == 0
    with Image.open(strip) as picture:
        assert picture.size == (48, 12)
        assert picture.getpixel((15, 0)) == (255, 255, 255)


def test_a_picture_of_another_shape_is_not_stretched_and_says_so(
    room: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for number, (words, size, told) in enumerate((
        (["--width", "64"], (64, 48), False),
        (["--height", "48"], (64, 48), False),
        (["--width", "96", "--height", "48"], (96, 48), True),
    )):  # fmt: skip
        file = tmp_path / f"{number}.png"
        orbit = ["--path", "orbit", "--frames", "1"]
        assert main(["render", room, "-o", str(file), *orbit, *words]) == 0
        assert ("note: pictures of 96 x 48 have another shape" in capsys.readouterr().err) == told
        with Image.open(file) as picture:
            assert picture.size == size
    with Image.open(tmp_path / "2.png") as wide, Image.open(tmp_path / "1.png") as own:
        middle = np.array(wide, dtype=int)[:, 16:80]
        assert abs(middle - np.array(own, dtype=int)).max() <= 2


def test_render_takes_cameras_of_a_file(room: str, tmp_path: Path):
    own, inputs = tmp_path / "own.png", tmp_path / "inputs.png"
    assert main(["render", room, "-o", str(own), "--path", f"{room}/cameras.json"]) == 0
    assert main(["render", room, "-o", str(inputs)]) == 0
    assert own.read_bytes() == inputs.read_bytes()


def test_render_refuses_what_is_not_there(room: str, tmp_path: Path, capsys: pytest.CaptureFixture):
    strip = str(tmp_path / "strip.png")
    for words, message in {
        ("-o", strip, "--only", "2"): "no object 2 in this scene; its ids are: 1, 3",
        ("-o", strip, "--path", "nowhere.json"): "no camera path nowhere.json",
        ("-o", strip, "--path", f"{room}/objects.json"): "give a list of cameras",
        ("-o", strip, "--path", "orbit", "--frames", "0"): "frames must lie in 1..",
        ("-o", strip, "--frames", "-3"): "frames must lie in 1..",
        ("-o", strip, "--path", "orbit", "--frames", "90000"): "90000 pictures of 32 x 24",
        ("-o", strip, "--fps", "0"): "fps must be at least 1, got 0",
        ("-o", strip, "--height", "0"): "height must be a whole number of at least 1 pixel, got 0",
        ("-o", strip, "--width", "-4"): "width must be",
        ("-o", strip, "--width", "1000000000"): "a picture may have 33,554,432",
        ("-o", str(tmp_path / "a.gif")): "must end in .png or .mp4",
    }.items():
        assert main(["render", room, *words]) == 2
        assert message in capsys.readouterr().err
    assert main(["render", room, "-o", str(tmp_path / "folder"), "--only", "2"]) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["room.itk"]


def test_render_writes_a_film(room: str, tmp_path: Path):
    imageio = pytest.importorskip("imageio.v3")
    film = tmp_path / "film.mp4"
    assert main(["render", room, "-o", str(film), "--path", "orbit", "--frames", "4"]) == 0
    assert imageio.imread(film).shape == (4, 24, 32, 3)
    # H.264 wants even sides.
    words = ["--frames", "2", "--path", "orbit", "--height", "21", "--overwrite"]
    assert main(["render", room, "-o", str(film), *words]) == 0
    assert imageio.imread(film).shape == (2, 22, 28, 3)


def test_export_writes_a_ply_of_all_or_one(room: str, tmp_path: Path):
    whole, one = tmp_path / "room.ply", tmp_path / "one.ply"
    assert main(["export", room, "-o", str(whole), "--with-ids"]) == 0
    assert len(read_ply(whole).gaussians.means) == 40
    assert b"comment instok3d units: arbitrary\n" in whole.read_bytes()
    assert main(["export", room, "-o", str(one), "--only", "3", "--sh", "0"]) == 0
    scene = instok3d.load(room)
    torch.testing.assert_close(read_ply(one).gaussians.means, scene.part(3).means)
    assert main(["export", room, "-o", str(one)]) == 2
    assert main(["export", room, "-o", str(tmp_path / "room.obj")]) == 2


@pytest.mark.parametrize(
    ("words", "name"), [(["export"], "a.ply"), (["render"], "a.png"), (["render"], "folder")]
)
def test_what_another_run_has_written_meanwhile_is_kept(
    room: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], name: str,
    capsys: pytest.CaptureFixture[str],
):  # fmt: skip
    output = tmp_path / name
    load = Scene.load

    def while_another_writes(path: Path) -> Scene:
        file = output if output.suffix else output / "001.png"
        file.parent.mkdir(exist_ok=True)
        file.write_text("mine")
        return load(path)

    monkeypatch.setattr(Scene, "load", while_another_writes)
    assert main([*words, room, "-o", str(output)]) == 2
    assert "has come to be there meanwhile" in capsys.readouterr().err
    assert (output if output.suffix else output / "001.png").read_text() == "mine"


def test_the_version_is_that_of_the_package():
    project = Path(__file__).resolve().parents[2] / "pyproject.toml"
    assert f'version = "{instok3d.__version__}"' in project.read_text()
