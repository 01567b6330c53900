"""The solver of cameras runs on one thread, its kernels on all; no number of them changes a bit."""

import threading
from collections.abc import Iterator

import pytest
import torch

from instok3d.backbones.nano import alignment, pair_cameras
from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.backbones.nano.bundle_problem import SolveSettings
from instok3d.backbones.nano.native_kernels import kernels
from instok3d.backbones.nano.pair_cameras import solve_views
from instok3d.backbones.nano.pair_matches import PairMatches, PhotoViews
from instok3d.backbones.nano.threads import all_threads, one_thread
from instok3d.geometry.cameras import intrinsics_from_field_of_view
from instok3d.types import Views


@pytest.fixture(autouse=True)
def _as_before() -> Iterator[None]:
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def test_one_thread_inside_and_as_before_after_an_error_too():
    torch.set_num_threads(3)
    with all_threads():
        assert torch.get_num_threads() == 3
    with one_thread():
        assert torch.get_num_threads() == 1
        with one_thread(), all_threads():
            assert torch.get_num_threads() == 3
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == 3
    with pytest.raises(KeyError), one_thread(), all_threads():
        raise KeyError
    assert torch.get_num_threads() == 3


def test_a_python_thread_that_enters_meanwhile_restores_the_number_of_the_first():
    torch.set_num_threads(3)
    seen: list[int] = []
    worker_is_inside, main_has_left = threading.Event(), threading.Event()

    def work() -> None:
        with one_thread():
            seen.append(torch.get_num_threads())
            with all_threads():
                seen.append(torch.get_num_threads())
            worker_is_inside.set()
            main_has_left.wait(60)
            seen.append(torch.get_num_threads())
        seen.append(torch.get_num_threads())

    worker = threading.Thread(target=work)
    with one_thread():
        worker.start()
        assert worker_is_inside.wait(60)
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == 3
    main_has_left.set()
    worker.join()
    assert seen == [1, 3, 1, 3]
    assert torch.get_num_threads() == 3


def matched_views() -> tuple[list[PairMatches], PhotoViews]:
    """Views of noise with the matches of an untrained backbone, all of high confidence."""
    torch.manual_seed(0)
    backbone = NanoBackbone(NanoConfig(width=64, layers=1))
    images = torch.rand(1, 3, 3, 64, 64)
    with torch.no_grad():
        raw = backbone.encode(Views(images=images))
        matches = backbone.find_matches(raw)
    intrinsics = intrinsics_from_field_of_view(torch.tensor(1.0), 64, 64).expand(1, 3, 3, 3)
    for pair in matches:
        pair.of_a.confidence.fill_(0.9)
        pair.of_b.confidence.fill_(0.9)
    return matches, PhotoViews(images, raw.log_depths.exp(), intrinsics)


@pytest.mark.skipif(kernels is None, reason="the kernels are not built")
def test_any_number_of_threads_solves_for_the_same_bits(monkeypatch: pytest.MonkeyPatch):
    seen: set[tuple[str, int]] = set()

    def watch(module, name: str) -> None:
        real = getattr(module, name)

        def watched(*arguments, **keywords):
            seen.add((name, torch.get_num_threads()))
            return real(*arguments, **keywords)

        monkeypatch.setattr(module, name, watched)

    watch(pair_cameras, "adjust_bundle")
    watch(alignment, "search_native")
    watch(kernels, "align")
    watch(kernels, "bundle_equations")
    matches, views = matched_views()
    found = []
    for threads in (1, 2, 3):
        torch.set_num_threads(threads)
        seen.clear()
        found.append(solve_views(matches, views, SolveSettings(torch.ones(1, 3), True)))
        on_one, on_all = ("adjust_bundle", "search_native"), ("align", "bundle_equations")
        assert seen == {*((name, 1) for name in on_one), *((name, threads) for name in on_all)}
        assert torch.get_num_threads() == threads
    for other in found[1:]:
        for name, value in vars(found[0]).items():
            assert torch.equal(vars(other)[name], value), name
