"""The parts of benchmarks/gpu.py: functions from a setting to rows of its table.

Imported by name only, so that a part starts without the libraries of the others.
"""

from collections.abc import Callable
from importlib import import_module

from gpu_parts.rows import Row, Setting

Part = Callable[[Setting], list[Row]]


def _later(module: str, function: str, *arguments: object) -> Part:
    def part(setting: Setting) -> list[Row]:
        return getattr(import_module(f"gpu_parts.{module}"), function)(setting, *arguments)

    return part


BUILD = "gsplat"
"""The part that compiles, which takes minutes."""
PARTS: dict[str, Part] = {
    "machine": _later("measuring", "machine"),
    BUILD: _later("rendering", "build_gsplat"),
    "rasterizer": _later("rendering", "compare_backends"),
    "reconstruct": _later("reconstructing", "compare_devices"),
    "tests": _later("marked_tests", "run_marked_tests"),
    "forward-2view": _later("paper", "forward", 2),
    "forward-8view": _later("paper", "forward", 8),
    "train-scannet-2view": _later("paper", "training_step", "scannet-2view"),
    "train-scannet-8view": _later("paper", "training_step", "scannet-8view"),
    "train-scannet-adapt": _later("paper", "training_step", "scannet-adapt"),
    "ddp-1process": _later("sharing", "one_process", "ddp"),
    "fsdp-1process": _later("sharing", "one_process", "fsdp"),
    "ddp-2process": _later("sharing", "two_processes", "ddp"),
    "fsdp-2process": _later("sharing", "two_processes", "fsdp"),
}
"""Correctness first, then time and memory."""
