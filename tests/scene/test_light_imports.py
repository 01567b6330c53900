"""What a reconstruction does not import: a command should begin at once."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize("library", ["scipy", "sympy", "transformers"])
def test_reconstruct_is_imported_without(library: str):
    code = f"import sys, instok3d.scene.reconstruct; print({library!r} in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
