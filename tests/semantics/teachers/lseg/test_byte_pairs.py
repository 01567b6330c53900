from pathlib import Path

import pytest

from instok3d.semantics.teachers.lseg.byte_pairs import BytePairs, load_byte_pairs
from tiny_lseg import MERGES, write_merges


def test_merges_are_done_in_the_order_of_the_list():
    # 512 single pieces, then the merges in order: "chair" is the fourth, number 515.
    pairs = BytePairs(MERGES)
    begin, end = 512 + len(MERGES), 513 + len(MERGES)
    assert pairs.encode(["Chair"], 10).tolist() == [[begin, 515, end]]
    # No merge joins "do" with "or</w>": d and o go together first, then r</w> is alone.
    assert pairs.encode(["door"], 10).tolist() == [[begin, 516, 517, end]]


def test_shorter_texts_are_padded_behind_their_end():
    pairs = BytePairs(MERGES)
    first, second = pairs.encode(["chair", "chair chair"], 10).tolist()
    assert first == [518, 515, 519, 0]
    assert second == [518, 515, 515, 519]


def test_every_character_has_pieces():
    pairs = BytePairs(())
    ids = pairs.encode(["löwe 椅子 x_1 don't\n\t!?"], 77)[0]
    assert len(set(ids.tolist())) > 10
    assert int(ids.max()) == pairs.size - 1


def test_the_twin_of_transformers(tmp_path: Path):
    transformers = pytest.importorskip("transformers")
    pairs = load_byte_pairs(write_merges(tmp_path))
    vocabulary = pairs.ids | {"<|startoftext|>": pairs.size - 2, "<|endoftext|>": pairs.size - 1}
    twin = transformers.CLIPTokenizer(vocab=vocabulary, merges=[*MERGES])
    texts = ["a chair", "the  Door's 12 chairs, isn't it?!", "CHAIR-door", "ÉTÉ 椅子"]
    for text in texts:
        assert pairs.encode([text], 77)[0].tolist() == twin(text).input_ids


def test_a_text_of_too_many_tokens_is_refused():
    with pytest.raises(ValueError, match=r"'chair .* has 9 tokens, .* takes 8: say it in fewer"):
        BytePairs(MERGES).encode(["chair " * 9], 10)


def test_a_missing_list_says_where_it_comes_from(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"fetch merges\.txt of .*clip-vit-base-patch32"):
        load_byte_pairs(tmp_path / "merges.txt")


@pytest.mark.parametrize(
    "content", [b"", b"c h\n", b"#version: 0.2\nc h\nc\n", b"#version: 0.2\nc h a\n", b"\xff\xfe"]
)
def test_a_damaged_list_is_named(tmp_path: Path, content: bytes):
    path = tmp_path / "merges.txt"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"merges\.txt is damaged"):
        load_byte_pairs(path)
