"""Credits go from the rooms to the run, and from the run to the card of its model."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from fake_rooms import FakeRooms
from instok3d.data.joined import JoinedScenes
from instok3d.files import write_safetensors
from instok3d.training.credits import read_credits
from instok3d.training.export import export_model
from instok3d.training.loop import train
from toy_stage import TINY, ToyStage

ONE_STEP = replace(TINY, steps=1)


class CreditedRooms(FakeRooms):
    """Rooms with a piece of someone else in them."""

    credits = ("Chair (chair1) by Ada, CC-BY-3.0",)


def test_a_card_credits_what_the_rooms_show(tmp_path):
    train(ONE_STEP, ToyStage(), CreditedRooms(4, 16), tmp_path)
    assert read_credits(tmp_path) == list(CreditedRooms.credits)
    card = export_model(tmp_path, tmp_path / "model.safetensors")
    assert card["credits"] == list(CreditedRooms.credits)


def test_rooms_of_this_package_alone_need_no_credits(tmp_path):
    train(ONE_STEP, ToyStage(), FakeRooms(4, 16), tmp_path)
    assert not (tmp_path / "credits.json").exists()
    assert "credits" not in export_model(tmp_path, tmp_path / "model.safetensors")


def test_resumed_and_inherited_runs_keep_what_they_owe(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    train(ONE_STEP, ToyStage(), CreditedRooms(4, 16), first)
    train(replace(TINY, steps=2), ToyStage(), FakeRooms(4, 16), first, resume=True)
    assert read_credits(first) == list(CreditedRooms.credits)
    train(ONE_STEP, ToyStage(), FakeRooms(4, 16), second, init_from=first)
    assert read_credits(second) == list(CreditedRooms.credits)


def test_weights_from_a_file_bring_the_credits_of_its_card(tmp_path):
    train(ONE_STEP, ToyStage(), FakeRooms(4, 16), tmp_path / "first")
    weights = ToyStage().build_model().state_dict()
    card = json.dumps({"credits": ["Vase (vase1) by Bea, MIT"]})
    write_safetensors(tmp_path / "model.safetensors", weights, {"card": card})
    train(ONE_STEP, ToyStage(), CreditedRooms(4, 16), tmp_path / "second",
          init_from=tmp_path / "model.safetensors")  # fmt: skip
    assert read_credits(tmp_path / "second") == [
        *CreditedRooms.credits,
        "Vase (vase1) by Bea, MIT",
    ]


def test_joined_rooms_owe_what_each_of_them_owes():
    joined = JoinedScenes([FakeRooms(2, 16), CreditedRooms(2, 16, first_seed=9)])
    assert joined.credits == list(CreditedRooms.credits)
    assert JoinedScenes([FakeRooms(2, 16)]).credits == []


@pytest.mark.parametrize("text", ["{", '{"a": 1}', "[3]", '["two\\nlines"]', '[""]'])
def test_damaged_credits_are_named(tmp_path: Path, text: str):
    (tmp_path / "credits.json").write_text(text)
    with pytest.raises(ValueError, match=r"credits\.json is damaged"):
        read_credits(tmp_path)
