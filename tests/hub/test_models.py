"""Models pushed, fetched and used, through a stand-in of the hub."""

import json
import re
import sys
import traceback
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from hub_server import TOKEN, StandIn
from instok3d.cli import main
from instok3d.errors import MissingWeightsError
from instok3d.files import sha256_of
from instok3d.hub.library import explained
from instok3d.hub.manifest import manifest_of
from instok3d.hub.references import HubReference
from instok3d.model.files import load_model, save_model
from instok3d.scene.hub_model import ModelFile, find_model, push_model
from instok3d.scene.reconstruct import reconstruct
from instok3d.semantics.files import save_semantics, tokenizer_digest
from instok3d.semantics.model import SemanticModel
from instok3d.semantics.teachers.file import teacher_tensors
from instok3d.semantics.tokens import SemanticTokensConfig
from made_encoder import CHANNELS, write_encoder
from made_model import made_model, made_photos

MAIN_NOTE = r"hub:ada/rooms is hub:ada/rooms@[0-9a-f]{40}: write this to get the same again"


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_model(tmp_path_factory.mktemp("model") / "own.safetensors")


def made_semantics(model: Path, path: Path, *, encoder: bool) -> Path:
    tokenizer, teacher = load_model(model), write_encoder(path)
    torch.manual_seed(1)
    sizes = SemanticTokensConfig(feature_channels=CHANNELS, residual_channels=2, group_layers=1)
    save_semantics(
        SemanticModel(tokenizer, sizes), path, encoder=teacher.name,
        tokenizer_sha256=tokenizer_digest(tokenizer), card={},
        beside=teacher_tensors(teacher) if encoder else ({}, {}),
    )  # fmt: skip
    return path


def test_a_model_is_pushed_used_and_its_commit_recorded(
    hub: StandIn, model: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    assert main(["models", "push", str(model), "hub:ada/rooms", "--licence", "mit", "--json"]) == 0
    name = json.loads(capfd.readouterr().out)["name"]
    repository = hub.repositories["model", "ada/rooms"]
    assert name == f"hub:ada/rooms@{repository.newest}"
    assert repository.private
    tree = repository.trees[repository.newest]
    assert set(tree) == {".gitattributes", "README.md", "instok3d.json", "model.safetensors"}
    assert tree["model.safetensors"] == model.read_bytes()
    card = tree["README.md"].decode()
    assert 'license: "mit"' in card.split("---")[1]
    assert sha256_of(model) in card
    assert "--model hub:ada/rooms " in card
    made_photos(tmp_path / "photos")
    words = ["reconstruct", str(tmp_path / "photos"), "--refine", "0", "--json"]
    assert main([*words, "--model", "hub:ada/rooms", "-o", str(tmp_path / "a.itk")]) == 0
    said = capfd.readouterr()
    made = json.loads(said.out)["provenance"]
    assert (made["model"], made["model_sha256"]) == (name, sha256_of(model))
    assert f"note: hub:ada/rooms is {name}: write this" in said.err
    hub.asked.clear()
    assert main([*words, "--model", name, "-o", str(tmp_path / "b.itk")]) == 0
    assert "note: hub:" not in capfd.readouterr().err
    assert not any("rooms" in asked for asked in hub.asked)  # a commit that is here
    for file in ("gaussians.safetensors", "scene.json"):
        first, second = tmp_path / "a.itk" / file, tmp_path / "b.itk" / file
        assert first.read_bytes() == second.read_bytes()


def test_semantics_come_with_the_model(hub: StandIn, model: Path, tmp_path: Path):
    semantics = made_semantics(model, tmp_path / "s.safetensors", encoder=True)
    pushed = push_model(model, "hub:ada/rooms", semantics=semantics)
    found = find_model(str(pushed.reference))
    assert found.semantics is not None
    assert found.semantics.read_bytes() == semantics.read_bytes()
    photos = made_photos(tmp_path / "photos")
    scene = reconstruct(photos, model=str(pushed.reference), refine=0)
    assert len(scene.semantics) == 1
    assert all(item.label for item in scene.objects)
    assert not reconstruct(photos, model=found.name, refine=0, semantics="none").semantics


def test_semantics_without_encoder_or_of_another_model_are_not_pushed(
    hub: StandIn, model: Path, tmp_path: Path
):
    bare = made_semantics(model, tmp_path / "bare.safetensors", encoder=False)
    with pytest.raises(ValueError, match="does not hold the encoder"):
        push_model(model, "hub:ada/rooms", semantics=bare)
    torch.manual_seed(9)
    other = made_model(tmp_path / "other.safetensors")
    tokenizer = load_model(other)
    with torch.no_grad():
        next(tokenizer.parameters()).add_(1)
    changed = made_semantics(model, tmp_path / "of.safetensors", encoder=True)
    save_model(tokenizer, other, card={})
    with pytest.raises(ValueError, match="belongs to another model"):
        push_model(other, "hub:ada/rooms", semantics=changed)
    (tmp_path / "x.safetensors").write_bytes(b"x")
    with pytest.raises(ValueError, match="not a whole safetensors file"):
        push_model(tmp_path / "x.safetensors", "hub:ada/rooms")
    assert not hub.repositories


def test_a_second_push_replaces_what_the_first_left_and_keeps_a_card_of_ones_own(
    hub: StandIn, model: Path, tmp_path: Path
):
    semantics = made_semantics(model, tmp_path / "s.safetensors", encoder=True)
    first = push_model(model, "hub:ada/rooms", semantics=semantics, public=True)
    assert not first.private
    assert not first.kept_card
    repository = hub.repositories["model", "ada/rooms"]
    repository.commit(repository.trees[repository.newest] | {"README.md": b"Ada's own words"})
    second = push_model(model, "hub:ada/rooms")
    assert second.kept_card
    tree = repository.trees[repository.newest]
    assert "semantics.safetensors" not in tree
    assert tree["README.md"] == b"Ada's own words"
    assert find_model(str(second.reference)).semantics is None
    assert find_model(str(first.reference)).semantics is not None  # the old commit has it still


def test_a_repository_of_something_else_is_left_alone(hub: StandIn, model: Path):
    repository = hub.made("ada/notes", {"notes.txt": b"x"})
    with pytest.raises(ValueError, match=r"holds files that are no model .*notes\.txt"):
        push_model(model, "hub:ada/notes")
    assert len(repository.trees) == 1
    with pytest.raises(ValueError, match=r"leave @main out"):
        push_model(model, "hub:ada/notes@main")


@pytest.mark.filterwarnings("ignore:hub")
def test_what_is_not_what_was_pushed_is_refused_and_fetched_anew(
    hub: StandIn, model: Path, cache: Path
):
    good = {"model.safetensors": model}
    text = manifest_of("model", good).to_json().encode()
    data = bytearray(model.read_bytes())
    data[-1] ^= 1
    for wrong, said in ((bytes(data), "SHA-256 is [0-9a-f]{64}, wanted"), (b"x", "has 1 bytes")):
        hub.made("ada/rooms", {"model.safetensors": wrong, "instok3d.json": text})
        with pytest.raises(ValueError, match=f"not the file that was pushed: .*{said}"):
            find_model("hub:ada/rooms")
    repository = hub.made("ada/rooms", {"model.safetensors": model.read_bytes(),
                                        "instok3d.json": text})  # fmt: skip
    found = find_model(f"hub:ada/rooms@{repository.newest}")
    assert found.path is not None
    found.path.resolve().write_bytes(bytes(data))  # the cache is harmed
    with pytest.raises(ValueError, match="thrown away, try again"):
        find_model(found.name)
    assert find_model(found.name) == found
    assert found.path.read_bytes() == model.read_bytes()


def test_only_files_of_a_model_are_asked_for(hub: StandIn, model: Path):
    pushed = push_model(model, "hub:ada/rooms")
    repository = hub.repositories["model", "ada/rooms"]
    repository.commit(repository.trees[repository.newest] | {"run.py": b"x", "a.pkl": b"x"})
    hub.asked.clear()
    with pytest.warns(UserWarning, match=MAIN_NOTE):
        found = find_model("hub:ada/rooms")
    assert found.name != str(pushed.reference)
    files = {asked.split("/")[-1] for asked in hub.asked if "/resolve/" in asked}
    assert files == {"instok3d.json", "model.safetensors"}


@pytest.mark.parametrize(
    ("name", "tree", "said"),
    [
        ("hub:ada/none", {}, "is no model that this account may see: log in"),
        ("hub:ada/rooms@v9", {}, "is there, but without this revision"),
        ("hub:ada/rooms@main", {"a.bin": b""}, "holds no model of instok3d"),
        ("hub:ada/rooms@main", {"instok3d.json": b"{"}, r"instok3d\.json is damaged"),
    ],
)
def test_what_the_hub_lacks_is_said_in_one_line_with_the_exit_code_of_missing_weights(
    hub: StandIn, name: str, tree: dict, said: str, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):  # fmt: skip
    hub.made("ada/rooms", tree)
    made_photos(tmp_path / "photos")
    words = ["reconstruct", str(tmp_path / "photos"), "-o", str(tmp_path / "a.itk")]
    assert main([*words, "--model", name]) == (2 if "damaged" in said else 4)
    last = capsys.readouterr().err.splitlines()[-1]
    assert re.search(said, last)
    assert not (tmp_path / "a.itk").exists()


def test_without_network_one_line_says_so_and_nothing_is_left(
    no_network: None, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(MissingWeightsError, match=r"hub:ada/rooms cannot be had from the hub \(.*"):
        find_model("hub:ada/rooms")
    with pytest.raises(MissingWeightsError, match="cannot be had"):
        find_model("hub:ada/rooms@" + "0" * 40)
    assert main(["models", "push", str(model), "hub:ada/rooms"]) == 2
    assert "cannot be had from the hub" in capsys.readouterr().err


def test_who_may_not_write_is_told_to_log_in_and_no_token_is_said(
    hub: StandIn, model: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    assert main(["models", "push", str(model), "hub:bob/rooms", "--debug"]) == 2
    assert "refused by the hub (403): log in with `hf auth login`" in capfd.readouterr().err
    monkeypatch.setenv("HF_TOKEN", TOKEN + "X")
    assert main(["models", "push", str(model), "hub:ada/rooms", "--debug"]) == 2
    said = capfd.readouterr()
    assert "refused by the hub (401)" in said.err
    assert TOKEN not in said.err + said.out


def test_an_error_that_quotes_the_token_is_told_without_it(hub: StandIn):
    with pytest.raises(ConnectionError) as caught, explained(HubReference("ada/rooms"), "model"):
        raise RuntimeError(f"illegal header 'Bearer {TOKEN}'")
    assert str(caught.value) == "hub:ada/rooms cannot be had from the hub (RuntimeError)"
    assert TOKEN not in "".join(traceback.format_exception(caught.value))


def test_without_the_hubs_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, model: Path):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(MissingWeightsError, match=r"pip install 'instok3d\[models\]'"):
        find_model("hub:ada/rooms")
    with pytest.raises(ModuleNotFoundError, match="huggingface-hub, which is not installed"):
        push_model(model, "hub:ada/rooms")


@pytest.mark.filterwarnings("ignore:the default|.*only one photo")
def test_a_batch_takes_the_same_commit_for_all_its_scenes(
    hub: StandIn, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    name = str(push_model(model, "hub:ada/rooms").reference)
    (tmp_path / "rooms").mkdir()
    for room in "ab":
        made_photos(tmp_path / "rooms" / room)
    words = ["batch", str(tmp_path / "rooms"), "-o", str(tmp_path / "out"), "--refine", "0"]
    assert main([*words, "--model", "hub:ada/rooms"]) == 0
    assert capsys.readouterr().err.count(f"hub:ada/rooms is {name}") == 1
    assert f'"{name}"' in (tmp_path / "out" / "batch.json").read_text()
    headers = [json.loads(file.read_text()) for file in (tmp_path / "out").glob("*/scene.json")]
    assert [header["provenance"]["model"] for header in headers] == [name] * 2


def test_a_server_that_is_no_hub_is_out_of_reach(hub: StandIn, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("HF_ENDPOINT", f"{hub.url}/elsewhere")
    with pytest.raises(MissingWeightsError, match="hub:ada/rooms cannot be had from the hub"):
        find_model("hub:ada/rooms")


def test_files_of_this_machine_are_not_looked_up(no_network: None):
    assert find_model(None) == ModelFile(None)
    assert find_model("a.safetensors") == ModelFile(Path("a.safetensors"))
    assert replace(find_model(Path("b")), name="x").name == "x"
