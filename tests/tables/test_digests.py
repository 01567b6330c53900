import os
from hashlib import sha256

import pytest

from instok3d.tables import digests
from instok3d.tables.digests import digest_of


def test_a_file_is_hashed_once_until_it_changes(tmp_path, monkeypatch):
    file, calls, whole = tmp_path / "weights", [], digests.sha256_of
    monkeypatch.setattr(digests, "sha256_of", lambda path: calls.append(path) or whole(path))
    file.write_bytes(b"one")
    assert digest_of(file) == digest_of(file) == sha256(b"one").hexdigest()
    assert len(calls) == 1
    file.write_bytes(b"two")
    os.utime(file, ns=(1, 1))  # another time of change, even on a coarse clock
    assert digest_of(file) == sha256(b"two").hexdigest()
    with pytest.raises(FileNotFoundError):
        digest_of(tmp_path / "nothing")
