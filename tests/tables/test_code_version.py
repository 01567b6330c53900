from instok3d.tables.code_version import MEASURING, PACKAGE, TRAINING, code_hash


def test_the_hash_follows_the_code_that_matters_and_no_other(tmp_path):
    (tmp_path / "model").mkdir()
    (tmp_path / "evaluation").mkdir()
    source = tmp_path / "model" / "a.py"
    source.write_text("one")

    def hashes() -> tuple[str, str]:
        code_hash.cache_clear()
        return code_hash("training", tmp_path), code_hash("measuring", tmp_path)

    first = hashes()
    (tmp_path / "model" / "notes.md").write_text("text")
    (tmp_path / "cli.py").write_text("other")
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "filled.py").write_text("other")
    assert hashes() == first
    (tmp_path / "tables" / "measuring.py").write_text("how")
    assert hashes()[0] == first[0]
    assert hashes()[1] != first[1]
    first = hashes()
    (tmp_path / "evaluation" / "b.py").write_text("two")
    assert hashes()[0] == first[0]
    assert hashes()[1] != first[1]
    source.write_text("changed")
    assert hashes()[0] != first[0]


def test_the_folders_are_there():
    assert all((PACKAGE / part).exists() for part in MEASURING)
    assert set(TRAINING) < set(MEASURING)
