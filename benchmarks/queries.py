"""What a question costs: one feature for each group, or one for each Gaussian.

python benchmarks/queries.py

100 groups and 131,072 Gaussians, 512 channels, float32 and float16 on disk: bytes, and the median
time of comparing one text with all, on one thread.
"""

import argparse
import time

import torch
from torch import Tensor
from torch.nn import functional

GROUPS, ANCHORS, RESIDUAL = 100, 1024, 8
GAUSSIANS = 131_072
CHANNELS = 512


def median_ms(features: Tensor, wanted: Tensor, repeats: int) -> float:
    """Of comparing one vector with all and finding the best five."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        (features @ wanted).topk(min(5, len(features)))
        times.append(1000 * (time.perf_counter() - begin))
    return sorted(times)[len(times) // 2]


def main() -> None:
    """Print both rows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=50)
    repeats = parser.parse_args().repeats
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(0)
    wanted = functional.normalize(torch.randn(CHANNELS, generator=generator), dim=0)
    stored = {
        "one feature for each group": (GROUPS, GROUPS * CHANNELS + ANCHORS * RESIDUAL),
        "one feature for each Gaussian": (GAUSSIANS, GAUSSIANS * CHANNELS),
    }
    print("| what is compared | vectors | numbers stored | bytes (float16) | ms for one text |")
    print("|---|---|---|---|---|")
    for name, (count, numbers) in stored.items():
        features = torch.randn(count, CHANNELS, generator=generator)
        taken = median_ms(functional.normalize(features, dim=1), wanted, repeats)
        print(f"| {name} | {count:,} | {numbers:,} | {2 * numbers:,} | {taken:.3f} |")


if __name__ == "__main__":
    main()
