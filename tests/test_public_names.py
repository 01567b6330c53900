"""What `import instok3d` offers."""

import subprocess
import sys

import pytest

import instok3d


def test_dir_lists_the_public_names_without_importing_torch():
    code = "import sys, instok3d; print(*dir(instok3d)); assert 'torch' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == sorted(instok3d.__all__)


@pytest.mark.parametrize("name", instok3d.__all__)
def test_every_public_name_is_there(name: str):
    assert getattr(instok3d, name) is not None


def test_another_name_is_refused_like_that_of_any_module():
    with pytest.raises(AttributeError, match="'instok3d' has no attribute 'Scenes'"):
        _ = instok3d.Scenes  # pyright: ignore[reportAttributeAccessIssue]
