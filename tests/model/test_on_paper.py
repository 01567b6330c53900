import subprocess
import sys

import pytest
import torch
from torch import nn

from instok3d.model.on_paper import on_paper


def test_networks_have_shapes_and_no_values():
    with on_paper():
        layer = nn.Linear(3, 4)
        nn.init.normal_(layer.weight)
        factor = nn.Parameter(0.5 * torch.randn(2, 5))
    assert layer.weight.is_meta
    assert layer.weight.shape == (4, 3)
    assert factor.is_meta
    assert factor.shape == (2, 5)
    with pytest.raises(RuntimeError):
        factor.sum().item()
    assert not torch.zeros(1).is_meta


def test_counting_imports_no_compiler():
    # Of torch's own symbolic mathematics, 80 MB and seconds, nothing is needed to count.
    code = (
        "import sys; from instok3d.model.memory import count_parameters as c\n"
        "from instok3d.backbones.nano.backbone import NanoConfig as N\n"
        "from instok3d.backbones.vggt import PAPER_VGGT as V\n"
        "from instok3d.model.tokenizer import PAPER as P, TokenizerConfig as T\n"
        "assert c(N(), T())[0] > 1e7 and c(V, P)[0] > 1e9\n"
        "assert 'sympy' not in sys.modules and 'torch._dynamo' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
