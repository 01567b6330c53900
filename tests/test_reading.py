"""JSON of sound values is read; all damage has one error, which names the file."""

import errno
import json
from pathlib import Path

import pytest

from instok3d.reading import naming_damage, number, parse_json, read_json, whole_number

DAMAGED = {
    "line 1 column 1": "",
    "Expecting": "{",
    "can't decode byte": b"\xff\xfe",
    "recursion": "[" * 100_000,
    "the number 1e999 is not finite": '{"x": 1e999}',
    "the number NaN is not finite": "[NaN]",
    "the number -Infinity is not finite": "[-Infinity]",
    "is too large": f"[{2**63}]",
    "99999999... is too large": "9" * 10_000,
    "the key 'x' stands twice": '{"x": 1, "y": 2, "x": 3}',
    "surrogates not allowed": r'["\ud800"]',
}


@pytest.mark.parametrize("reason", DAMAGED)
def test_what_json_cannot_hold_is_refused_in_one_line(tmp_path: Path, reason: str):
    file, content = tmp_path / "a.json", DAMAGED[reason]
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=f"a.json is damaged .*{reason}.*; make it again") as error:
        read_json(file, "make it again")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_sound_json_is_read_as_it_is(tmp_path: Path):
    value = {"a": [1, -(2**63), 2.5, None, True, "\u5c45\U0001f600"], "b": {}, "c": []}
    (tmp_path / "a.json").write_text(json.dumps(value))
    assert read_json(tmp_path / "a.json", "") == value
    (tmp_path / "a.json").write_text(json.dumps(value, ensure_ascii=False), "utf-8-sig")
    assert read_json(tmp_path / "a.json", "") == value
    assert parse_json("{}", "nothing", "") == {}
    with pytest.raises(FileNotFoundError, match=r"there is no file .*b\.json"):
        read_json(tmp_path / "b.json", "")


def test_numbers_are_numbers():
    assert (whole_number(3), number(3), number(2.5)) == (3, 3.0, 2.5)
    for value in (True, "3", 3.0, None, [3], -1):
        with pytest.raises(ValueError, match="is no whole number from 0 to 9"):
            whole_number(value, most=9)
    for value in (True, "3", None, [3]):
        with pytest.raises(ValueError, match="is no number"):
            number(value)


def test_errors_of_the_system_are_not_taken_for_damage():
    with pytest.raises(PermissionError), naming_damage("a.json", ""):
        raise PermissionError(errno.EACCES, "Permission denied", "a.json")
    with (
        pytest.raises(ValueError, match=r"a.json is damaged \(it lacks 'x'\); mend it"),
        naming_damage("a.json", "mend it"),
    ):
        raise KeyError("x")
