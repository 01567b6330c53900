"""Standard streams that are closed, full or cannot show a name never undo or stop the work."""

import json
import os
import subprocess
import sys
from pathlib import Path
from types import FrameType

import pytest

import instok3d
from instok3d.cli import streams
from instok3d.cli.streams import READER_GONE, Outlet
from made_model import made_model, made_photos

INSTOK3D = f"{sys.executable} -m instok3d"


def shell(command: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        ["bash", "-o", "pipefail", "-c", command],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
    )


def code(text: str) -> str:
    """A process that runs `text` after the command line has set its streams up."""
    return f'{sys.executable} -c "import os, sys; from instok3d.cli import main; {text}"'


def test_a_scene_is_made_though_all_streams_are_closed(tmp_path: Path):
    model = made_model(tmp_path / "random.safetensors")
    made_photos(tmp_path / "in")
    command = f"{INSTOK3D} reconstruct in -o out.itk --model {model} <&- >&- 2>&-"
    assert shell(command, tmp_path).returncode == 0
    assert len(instok3d.load(tmp_path / "out.itk").views) == 2


def test_files_never_take_the_place_of_a_closed_stream(tmp_path: Path):
    # The next file that is opened would get the number 2, and with it what a library prints.
    text = "main(['--version']); print(open(os.devnull).fileno() > 2)"
    shown = shell(code(text) + " 2>&-", tmp_path)
    assert (shown.returncode, shown.stdout.split()[-1]) == (0, b"True")


def test_a_reader_that_is_gone_stops_no_work(tmp_path: Path):
    text = (
        "main(['--version']); print(8 * 2**20 * 'x', file=sys.{}); sys.{}.flush(); "
        "open('done', 'w').close(); sys.exit(main(['--version']))"
    )
    for name, command in {
        "stdout": f"{code(text.format('stdout', 'stdout'))} | true",
        "stderr": f"{code(text.format('stderr', 'stderr'))} 2> >(true) >/dev/null",
    }.items():
        assert shell(command, tmp_path).returncode == 0, name
        (tmp_path / "done").unlink()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_result_that_could_not_be_written_is_an_error_and_a_lost_note_is_none(tmp_path: Path):
    assert shell(f"{INSTOK3D} --version > /dev/full", tmp_path).returncode == 3
    assert shell(f"{INSTOK3D} --version 2> /dev/full", tmp_path).returncode == 0
    assert shell(f"{INSTOK3D} nonsense 2> /dev/full", tmp_path).returncode == 2


def test_names_that_a_stream_cannot_show_are_escaped(tmp_path: Path):
    text = "main(['--version']); print('uni\\u5c45 \\xe9 \\udcff.itk')"
    for encoding in ("ascii", "latin-1", "utf-8"):
        shown = shell(code(text), tmp_path, PYTHONIOENCODING=encoding)
        assert shown.returncode == 0, encoding
        assert rb"\udcff.itk" in shown.stdout
        assert rb"uni\u5c45" in shown.stdout or encoding == "utf-8"


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_json_with_any_name_is_json_on_any_stream(tmp_path: Path, encoding: str):
    names = "uni\u5c45", "caf\xe9", "\U0001f600", "\udcff"
    text = (
        "main(['--version']); from instok3d.cli.info import print_json; "
        f"print_json({{'names': {list(names)!a}}})"
    ).replace("\\", "\\\\")
    shown = shell(code(text), tmp_path, PYTHONIOENCODING=encoding)
    assert shown.returncode == 0
    found = json.loads(shown.stdout.partition(b"\n")[2].decode(encoding))
    assert found == {"names": list(names)}


@pytest.mark.parametrize("line_buffering", [False, True])
def test_what_a_signal_interrupts_is_never_written_twice(tmp_path: Path, line_buffering: bool):
    # A signal's exception comes between two instructions of Python: at each one in turn.
    interrupted, instruction = True, 0
    while interrupted:
        path = tmp_path / str(instruction)
        with path.open("wb") as file:
            stream = Outlet(
                file.fileno(), READER_GONE, encoding="utf-8", line_buffering=line_buffering
            )
            interrupted = print_interrupted(stream, instruction)
            stream.close()
        assert path.read_text() in (("", "line", "line\n") if interrupted else ("line\n",))
        instruction += 1
    assert instruction > 10


def print_interrupted(stream: Outlet, instruction: int) -> bool:
    """Print a line; an instruction of the stream's Python code, counted from 0, is interrupted."""
    left = instruction

    def trace(frame: FrameType, event: str, _argument: object):
        nonlocal left
        if frame.f_code.co_filename != streams.__file__:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            left -= 1
            if left < 0:
                raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        print("line", file=stream, flush=True)
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False
