import os
import pickle
import re
import sys
import types
import zipfile
from collections import OrderedDict
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from instok3d.files import sha256_of
from instok3d.weights.conversion import convert_checkpoint, convert_here, tensor_levels
from instok3d.weights.writing import write_tensors
from mutations import of_bytes, of_zip, survive


class Evil:
    """Unpickling it writes a file."""

    def __init__(self, mark: Path):
        self.mark = mark

    def __reduce__(self):
        return os.system, (f"touch {self.mark}",)


def test_a_checkpoint_becomes_a_safetensors_file(tmp_path: Path):
    weight = torch.arange(6.0).reshape(2, 3)
    content = {"state_dict": {"w": weight, "same": weight[0], "turned": weight.T, "step": 3}}
    torch.save(content, tmp_path / "a.ckpt")
    output = tmp_path / "a.safetensors"
    done = convert_checkpoint(tmp_path / "a.ckpt", output)
    found = load_file(output)
    torch.testing.assert_close(
        found, {"w": weight, "same": weight[0].clone(), "turned": weight.T.contiguous()}
    )
    assert (done.tensors, done.level, done.left_out) == (3, "state_dict", ("step",))
    assert done.bytes == output.stat().st_size
    assert done.sha256 == sha256_of(output)


def test_files_of_old_torch_are_read_too(tmp_path: Path):
    torch.save({"w": torch.ones(2)}, tmp_path / "a.pt", _use_new_zipfile_serialization=False)
    convert_here(tmp_path / "a.pt", tmp_path / "a.safetensors")
    assert load_file(tmp_path / "a.safetensors")["w"].tolist() == [1, 1]


def evil(folder: Path, way: str) -> tuple[Path, Path]:
    """A checkpoint, and the file that appears when its code has run."""
    bad, mark = folder / "bad.pt", folder / "it ran"
    if way == "pickle":
        bad.write_bytes(pickle.dumps(Evil(mark)))
    else:
        content = {"w": torch.ones(2), "x": Evil(mark)}
        torch.save(content, bad, _use_new_zipfile_serialization=way == "torch")
    return bad, mark


@pytest.mark.parametrize("way", ["pickle", "old torch", "torch"])
def test_a_checkpoint_that_would_run_code_is_refused(tmp_path: Path, way: str):
    bad, mark = evil(tmp_path, way)
    with pytest.raises(ValueError, match="is refused, it holds more than tensors") as refusal:
        convert_here(bad, tmp_path / "out.safetensors")
    assert not mark.exists()
    assert "weights_only" not in str(refusal.value)  # torch tells how to run it all the same
    assert re.search(": [Uu]nsupported ", str(refusal.value))


def test_classes_of_a_trainer_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # Lightning before 1.5 keeps the state of a callback under the callback's class.
    name = "pytorch_lightning.callbacks.model_checkpoint"
    module = types.ModuleType(name)
    callback = type("ModelCheckpoint", (), {"__module__": name})
    settings = type("AttributeDict", (dict,), {"__module__": name})
    module.ModelCheckpoint, module.AttributeDict = callback, settings
    monkeypatch.setitem(sys.modules, "pytorch_lightning", types.ModuleType("pytorch_lightning"))
    monkeypatch.setitem(
        sys.modules, "pytorch_lightning.callbacks", types.ModuleType("pytorch_lightning.callbacks")
    )
    monkeypatch.setitem(sys.modules, name, module)
    content = {
        "callbacks": {callback: {"best": torch.tensor(0.5)}},
        "hyper_parameters": settings(rate=0.1),
        "state_dict": {"net.w": torch.ones(2)},
    }
    torch.save(content, tmp_path / "a.ckpt")
    done = convert_checkpoint(tmp_path / "a.ckpt", tmp_path / "a.safetensors", level="state_dict")
    assert done.tensors == 1
    assert load_file(tmp_path / "a.safetensors")["net.w"].tolist() == [1, 1]


def test_functions_of_a_trainer_are_not_run(tmp_path: Path):
    # Whatever is called under such a name, an empty dictionary comes of it.
    mark = tmp_path / "it ran"
    code = f"cpytorch_lightning.os\nsystem\n(S'touch {mark}'\ntR."
    with zipfile.ZipFile(tmp_path / "bad.pt", "w") as archive:
        archive.writestr("bad/data.pkl", code)
        archive.writestr("bad/version", "3\n")
    with pytest.raises(ValueError, match=r"bad\.pt"):
        convert_checkpoint(tmp_path / "bad.pt", tmp_path / "bad.safetensors")
    assert not mark.exists()


def test_a_refusal_leaves_what_was_there(tmp_path: Path):
    bad, mark = evil(tmp_path, "torch")
    output = tmp_path / "out.safetensors"
    output.write_bytes(b"as it was")
    with pytest.raises(ValueError, match=r"bad\.pt is refused, it holds more than tensors"):
        convert_checkpoint(bad, output)
    assert not mark.exists()
    assert output.read_bytes() == b"as it was"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.pt", "out.safetensors"]


def test_two_places_with_tensors_need_a_choice(tmp_path: Path):
    content = {"model": {"w": torch.ones(1)}, "ema": {"w": torch.zeros(1)}}
    torch.save(content, tmp_path / "a.pt")
    output = tmp_path / "a.safetensors"
    with pytest.raises(ValueError, match=r"more than one place, 'model', 'ema': choose with"):
        convert_here(tmp_path / "a.pt", output)
    assert convert_here(tmp_path / "a.pt", output, level="ema").tensors == 1
    assert load_file(output)["w"].item() == 0
    with pytest.raises(ValueError, match="no tensors under 'emma'"):
        convert_here(tmp_path / "a.pt", output, level="emma")


def test_the_top_is_chosen_by_the_empty_level(tmp_path: Path):
    torch.save({"w": torch.ones(1), "ema": {"w": torch.zeros(1)}}, tmp_path / "a.pt")
    output = tmp_path / "a.safetensors"
    with pytest.raises(ValueError, match=r"more than one place, '' \(the top\), 'ema': choose"):
        convert_here(tmp_path / "a.pt", output)
    assert convert_checkpoint(tmp_path / "a.pt", output, level="").left_out == ("ema",)
    assert load_file(output)["w"].item() == 1
    assert convert_here(tmp_path / "a.pt", output, level="ema").level == "ema"


def test_levels_are_named_by_their_keys():
    weight = torch.ones(1)
    content = {"a": {"b": OrderedDict(w=weight)}, "n": 1, "c": {"w": weight, 3: "x"}}
    assert set(tensor_levels(content)) == {"a.b", "c"}
    assert set(tensor_levels({"w": weight})) == {""}
    assert tensor_levels([weight]) == {}


def test_what_is_no_checkpoint_is_named(tmp_path: Path):
    output = tmp_path / "out.safetensors"
    with pytest.raises(FileNotFoundError, match=r"no checkpoint .*none\.pt"):
        convert_checkpoint(tmp_path / "none.pt", output)
    torch.save({"w": torch.ones(1000)}, tmp_path / "whole.pt")
    (tmp_path / "cut.pt").write_bytes((tmp_path / "whole.pt").read_bytes()[:-500])
    (tmp_path / "empty.pt").write_bytes(b"")
    for name in ("cut.pt", "empty.pt"):
        with pytest.raises(ValueError, match=r"is (not a whole checkpoint|refused)"):
            convert_here(tmp_path / name, output)
    torch.save({"epoch": 3}, tmp_path / "numbers.pt")
    with pytest.raises(ValueError, match="holds no tensors under names"):
        convert_here(tmp_path / "numbers.pt", output)
    assert not output.exists()


def test_tensors_of_every_type_come_back(tmp_path: Path):
    tensors = {
        "half": torch.rand(3).half(), "brain": torch.rand(2, 2).bfloat16(),
        "long": torch.tensor([2**40]), "byte": torch.tensor([1, 2, 3], dtype=torch.uint8),
        "flag": torch.tensor([True, False]), "none": torch.zeros(0, 4), "one": torch.tensor(2.5),
    }  # fmt: skip
    digest = write_tensors(tmp_path / "a", tensors, {"b": "2", "a": "1"})
    found = load_file(tmp_path / "a")
    for name, value in tensors.items():
        assert found[name].dtype == value.dtype
        torch.testing.assert_close(found[name], value)
    again = dict(reversed(tensors.items()))
    assert write_tensors(tmp_path / "b", again, {"a": "1", "b": "2"}) == digest
    with pytest.raises(ValueError, match=r"tensor c is torch\.complex64"):
        write_tensors(tmp_path / "c", {"c": torch.zeros(1, dtype=torch.complex64)})
    assert write_tensors(tmp_path / "d", {}) == sha256_of(tmp_path / "d")


def test_a_dictionary_that_stands_in_many_places_is_found_once():
    level: dict = {"w": torch.ones(1)}
    for _ in range(60):  # 2**60 ways to the tensor
        level = {"a": level, "b": level}
    assert set(tensor_levels(level)) == {".".join("a" * 60)}


def test_a_dictionary_in_itself_is_found_once(tmp_path: Path):
    content: dict = {"model": {"w": torch.ones(1)}}
    content["self"] = content["model"]["parent"] = content
    assert set(tensor_levels(content)) == {"model"}
    torch.save(content, tmp_path / "a.pt")
    done = convert_checkpoint(tmp_path / "a.pt", tmp_path / "a.safetensors")
    assert (done.level, done.left_out) == ("model", ("parent",))


def test_dictionaries_however_deep_are_found():
    level: dict = {"w": torch.ones(1)}
    for _ in range(5000):
        level = {"a": level}
    assert len(tensor_levels(level)) == 1


def test_a_tensor_far_larger_than_its_file_is_refused(tmp_path: Path):
    torch.save({"w": torch.ones(1).expand(2**20, 2**20)}, tmp_path / "a.pt")
    with pytest.raises(ValueError, match=r"a\.pt asks for 4398046511104 bytes of tensors"):
        convert_checkpoint(tmp_path / "a.pt", tmp_path / "a.safetensors")
    assert [path.name for path in tmp_path.iterdir()] == ["a.pt"]


@pytest.mark.parametrize("zipped", [True, False])
def test_a_damaged_checkpoint_is_converted_or_refused_in_one_line(tmp_path: Path, zipped: bool):
    file, output = tmp_path / "a.pt", tmp_path / "a.safetensors"
    content = {"state_dict": {"w": torch.ones(4, 4), "b": torch.arange(3)}, "step": 3}
    torch.save(content, file, _use_new_zipfile_serialization=zipped)

    def read() -> None:
        try:
            convert_here(file, output)
        except ValueError as error:  # convert_checkpoint adds the name
            raise ValueError(f"{file} {error}") from error

    assert survive(file, read, of_zip if zipped else of_bytes, 120)
