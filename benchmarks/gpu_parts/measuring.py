"""Times, memory and rates of a device, and what a part says of them."""

import platform
import resource
import statistics
import time
from collections.abc import Callable

import torch
from torch import Tensor

from gpu_parts.rows import Row, Setting


def relative_error(value: Tensor, expected: Tensor) -> float:
    """Norm of the difference over that of the expected; 0 where both are empty or zero."""
    difference, size = (value.cpu() - expected.cpu()).norm(), expected.cpu().norm()
    return float(difference / size) if size > 0 else float(difference)


def synchronize(setting: Setting) -> None:
    """Wait for what the device still has to do."""
    if setting.on_gpu:
        torch.cuda.synchronize()


def seconds_of(setting: Setting, run: Callable[[], object], repeats: int = 5) -> float:
    """Median time of a call, after two that fetch memory and choose kernels."""
    times = []
    for number in range(1 + repeats if setting.toy else 2 + repeats):
        synchronize(setting)
        start = time.perf_counter()
        run()
        synchronize(setting)
        if number >= 1 + (not setting.toy):
            times.append(time.perf_counter() - start)
    return statistics.median(times)


def peak_bytes(setting: Setting) -> int:
    """Most memory of this process so far: of tensors on the GPU, or resident on the CPU."""
    if setting.on_gpu:
        return torch.cuda.max_memory_allocated()
    unit = 1 if platform.system() == "Darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def matrix_rate(setting: Setting) -> float:
    """bfloat16 operations a second in products of large random matrices."""
    side = 512 if setting.toy else 8192
    a, b = (torch.randn(side, side, device=setting.device, dtype=torch.bfloat16) for _ in "ab")
    return 2 * side**3 / seconds_of(setting, lambda: a @ b)


def copy_rate(setting: Setting) -> float:
    """Bytes a second that copying in the device's memory reads and writes."""
    source = torch.empty(2**22 if setting.toy else 2**30, dtype=torch.uint8, device=setting.device)
    target = torch.empty_like(source)
    return 2 * len(source) / seconds_of(setting, lambda: target.copy_(source))


def against_lower_bound(
    setting: Setting, seconds: float, flop: float, moved_bytes: float
) -> list[Row]:
    """A measured time beside the least that this device could take.

    The lower bound is the larger of two times: of the operations at the rate of large matrix
    products, of the bytes at the rate of copies, both measured here.
    """
    compute_s, memory_s = flop / matrix_rate(setting), moved_bytes / copy_rate(setting)
    least_s, binding = max((compute_s, "operations"), (memory_s, "bytes"))
    return [
        Row("time", f"{1e3 * seconds:.2f} ms"),
        Row("lower bound of the time", f"{1e3 * least_s:.3g} ms, by {binding}",
            f"{flop / 1e12:.3g} TFLOP, {moved_bytes / 1e9:.3g} GB"),
        Row("time over lower bound", f"{seconds / least_s:.3g}"),
    ]  # fmt: skip


def machine(setting: Setting) -> list[Row]:
    """What the device is and how fast it gets."""
    name = torch.cuda.get_device_name() if setting.on_gpu else platform.machine()
    memory = torch.cuda.get_device_properties(0).total_memory if setting.on_gpu else 0
    return [
        Row("device", f"{name}, {memory / 1e9:.0f} GB" if memory else name),
        Row("torch", f"{torch.__version__} on Python {platform.python_version()}"),
        Row("bfloat16 products", f"{matrix_rate(setting) / 1e12:.4g} TFLOP/s"),
        Row("copies", f"{copy_rate(setting) / 1e9:.4g} GB/s"),
    ]
