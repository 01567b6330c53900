"""Threads of the kernels: what one of them throws reaches Python, and ends no process."""

import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import instok3d.render
import patience
from instok3d.render import native_backend

NATIVE = Path(instok3d.render.__file__).parent / "native"

PROGRAM = """
#include <atomic>
#include <cstdio>
#include <new>
#include <stdexcept>

#include "team.hpp"

int main() {
  using namespace instok3d;
  for (int threads : {1, 2, 5}) {
    for (int place = 0; place < 3; ++place) {
      std::atomic<int> later{0};
      const auto fail = [&](std::int64_t task, int) {
        if (place == 1 && task == 7) throw std::bad_alloc();
        if (place == 2) throw std::runtime_error("all of them");
      };
      try {
        run_stages(threads, {
            {[] { return 100; }, fail},
            {[&] { if (place == 0) throw std::length_error("prepare"); return 100; },
             [&](std::int64_t, int) { ++later; }},
        });
        std::puts("nothing was thrown");
      } catch (const std::exception& error) {
        std::printf("%d %d %s %d\\n", threads, place, error.what(), later.load());
      }
    }
    std::atomic<int> sum{0};
    run_stages(threads, {{[] { return 100; }, [&](std::int64_t task, int) { sum += int(task); }}});
    std::printf("%d\\n", sum.load());
  }
}
"""


@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler")
@pytest.mark.skipif(not (NATIVE / "team.cpp").is_file(), reason="installed without its sources")
@pytest.mark.parametrize("flags", [["-fopenmp"], ["-pthread"]], ids=["OpenMP", "std::thread"])
def test_the_first_exception_of_any_thread_is_thrown_to_the_caller(tmp_path: Path, flags: list):
    (tmp_path / "main.cpp").write_text(PROGRAM)
    sources = [str(tmp_path / "main.cpp"), str(NATIVE / "team.cpp")]
    build = ["g++", "-std=c++17", "-O1", *flags, f"-I{NATIVE}", *sources, "-o"]
    subprocess.run([*build, str(tmp_path / "program")], check=True)
    ended = subprocess.run(
        [str(tmp_path / "program")],
        check=True,
        capture_output=True,
        text=True,
        timeout=patience.SECONDS,
    )
    expected = [
        line
        for threads in (1, 2, 5)
        for line in (
            f"{threads} 0 prepare 0", f"{threads} 1 std::bad_alloc 0",
            f"{threads} 2 all of them 0", "4950",
        )
    ]  # fmt: skip
    assert ended.stdout.splitlines() == expected


@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="allocation is replaced as glibc's"
)
@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler")
@pytest.mark.skipif(not (NATIVE / "team.cpp").is_file(), reason="installed without its sources")
@pytest.mark.parametrize("flags", [["-fopenmp"], ["-pthread"]], ids=["OpenMP", "std::thread"])
def test_no_allocation_that_fails_ends_the_process(tmp_path: Path, flags: list):
    names = ("team", "buffer", "binning", "rasterizer", "kernels_portable")
    sources = [
        Path(__file__).with_name("failing_memory.cpp"),
        *(NATIVE / f"{n}.cpp" for n in names),
    ]
    build = ["g++", "-std=c++17", "-O0", *flags, f"-I{NATIVE}", *map(str, sources), "-o"]
    subprocess.run([*build, str(tmp_path / "program")], check=True)
    ended = subprocess.run(
        [str(tmp_path / "program")], capture_output=True, text=True, timeout=patience.SECONDS
    )
    assert ended.stdout.splitlines() == [
        "1 threads, more than 20 thrown", "3 threads, more than 20 thrown", "and drawn",
    ], ended.stderr  # fmt: skip


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits are set as on Linux")
@pytest.mark.skipif(not native_backend.native_status().available, reason="kernels are not built")
@pytest.mark.parametrize("threads", [1, 2])
def test_out_of_memory_in_a_thread_is_a_memory_error(threads: int):
    # 20,000 Gaussians that each cover all 16,384 tiles: lists of more than a gigabyte, which the
    # threads ask for while they fill them.
    program = f"""
        import resource
        import torch
        from instok3d.render import render
        from instok3d.types import Cameras, Gaussians

        torch.set_num_threads({threads})
        count = 20_000
        means = torch.zeros(count, 3)
        means[:, 2] = 3
        gaussians = Gaussians(
            means, torch.eye(4)[:1].repeat(count, 1), torch.full((count, 3), 9.0),
            torch.full((count,), 0.5), torch.zeros(count, 1, 3), torch.zeros(count).long(),
        )
        K = torch.tensor([[[2000.0, 0, 1024], [0, 2000, 1024], [0, 0, 1]]])
        cameras = Cameras(torch.eye(4)[None], K)
        render(gaussians.rows(slice(0, 1)), cameras, 2048, 2048)  # the pool of threads
        used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        limit = used + 2**29
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
        try:
            render(gaussians, cameras, 2048, 2048)
        except MemoryError:
            print("MemoryError")
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        print(float(render(gaussians.rows(slice(0, 1)), cameras, 64, 64).alphas.max()) > 0)
    """
    ended = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True
    )
    assert ended.stdout.split() == ["MemoryError", "True"], ended.stderr
