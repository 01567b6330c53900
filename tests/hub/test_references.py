from pathlib import Path

import pytest

from instok3d.hub.references import HubReference, is_hub, parse_reference

COMMIT = "0123456789abcdef0123456789abcdef01234567"


@pytest.mark.parametrize(
    ("name", "repository", "revision", "pinned"),
    [
        ("hub:ada/rooms", "ada/rooms", None, False),
        ("hub:ada/rooms.v2@main", "ada/rooms.v2", "main", False),
        ("hub:ada/rooms@refs/pr/1", "ada/rooms", "refs/pr/1", False),
        (f"hub:ada/rooms@{COMMIT}", "ada/rooms", COMMIT, True),
        (f"hub:ada/rooms@{COMMIT[:7]}", "ada/rooms", COMMIT[:7], False),
    ],
)
def test_a_name_has_a_repository_and_perhaps_a_revision(
    name: str, repository: str, revision: str | None, pinned: bool
):
    for form in (name, Path(name)):
        found = parse_reference(form)
        assert found == HubReference(repository, revision)
        assert found.pinned == pinned
        assert str(found) == name
        assert is_hub(form)


@pytest.mark.parametrize(
    "name",
    ["hub:", "hub:ada", "hub:ada/rooms/x", "hub:ada/rooms@", "hub:../rooms", "hub:ada/..",
     "hub:ada/a b", "hub:ada/rooms@-x", "hub://ada/rooms", "hub:ada/rooms@a\n"],
)  # fmt: skip
def test_what_names_no_repository_is_refused(name: str):
    assert is_hub(name)
    with pytest.raises(ValueError, match="names no repository of the hub; wanted hub:USER/NAME"):
        parse_reference(name)


def test_other_names_are_not_of_the_hub():
    assert not any(map(is_hub, ["", "room.itk", "Hub:a/b", Path("a/hub:b"), None, 3]))
