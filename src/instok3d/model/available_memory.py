"""How much memory is free for this process, and how much it has."""

import os
from pathlib import Path

import torch

MEMINFO = Path("/proc/meminfo")
STATM = Path("/proc/self/statm")
CGROUP = Path("/sys/fs/cgroup")


def available_bytes(device: str | torch.device = "cpu") -> int | None:
    """Bytes that can still be had, None where the system does not say.

    On the CPU the least of what the machine has free and what the limits of the process's control
    group leave (containers, job schedulers); on CUDA what the device has free.
    """
    device = torch.device(device)
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    known = [each for each in (_machine_free(), _group_free()) if each is not None]
    return min(known) if known else None


def resident_bytes() -> int:
    """Bytes of memory that this process has now; 0 where the system does not say."""
    if not STATM.is_file():
        return 0
    return int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _machine_free() -> int | None:
    if MEMINFO.is_file():
        for line in MEMINFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    names = ("SC_AVPHYS_PAGES", "SC_PAGE_SIZE")
    if all(name in os.sysconf_names for name in names):
        return os.sysconf(names[0]) * os.sysconf(names[1])
    return None


def _group_free() -> int | None:
    """What the control group leaves, version 2 or 1; file pages it can drop count as free."""
    for limit, used, dropped in (
        ("memory.max", "memory.current", "inactive_file"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes", "total_inactive_file"),
    ):
        most, now = _number(CGROUP / limit), _number(CGROUP / used)
        if (
            most is not None and now is not None and most < 1 << 60
        ):  # version 1 writes 2^63 for none
            statistics = CGROUP / Path(limit).parent / "memory.stat"
            lines = statistics.read_text().splitlines() if statistics.is_file() else []
            droppable = [int(x.split()[1]) for x in lines if x.split()[0] == dropped]
            return max(0, most - now + sum(droppable))
    return None


def _number(path: Path) -> int | None:
    text = path.read_text().strip() if path.is_file() else ""
    return int(text) if text.isdecimal() else None
