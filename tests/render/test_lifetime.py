"""What a forward pass keeps for its backward pass goes with the graph, and without a word."""

import subprocess
import sys
import textwrap
import weakref

import pytest
import torch

from instok3d.render import native_status, render

pytestmark = pytest.mark.skipif(
    not native_status().available, reason=f"native kernels: {native_status().reason}"
)


@pytest.mark.parametrize("backward", [False, True])
def test_the_frame_of_a_picture_goes_with_the_picture(make_scene, backward: bool):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    gaussians.means.requires_grad_()
    pictures = render(gaussians, cameras, 8, 8, backend="native")
    graph = pictures.colors.grad_fn.next_functions[0][0]
    while not hasattr(graph, "frame"):
        graph = graph.next_functions[0][0]
    frame = weakref.ref(graph.frame)
    assert frame() is not None
    if backward:
        pictures.colors.sum().backward()
    del pictures, graph
    assert frame() is None


def test_a_graph_that_is_alive_when_python_ends_is_not_called_a_leak():
    program = """
        import torch
        from instok3d.render import render
        from instok3d.types import Cameras, Gaussians

        means = torch.tensor([[0.0, 0, 3]], requires_grad=True)
        gaussians = Gaussians(
            means, torch.eye(4)[:1], torch.ones(1, 3), torch.ones(1), torch.zeros(1, 1, 3),
            torch.zeros(1).long(),
        )
        cameras = Cameras(torch.eye(4)[None], torch.tensor([[[8.0, 0, 4], [0, 8, 4], [0, 0, 1]]]))
        pictures = render(gaussians, cameras, 8, 8, backend="native")
        raise RuntimeError("the end")
    """
    ended = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True
    )
    assert ended.stderr.rstrip().endswith("RuntimeError: the end")
