"""`instok3d push`: a scene to the Hugging Face hub."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from instok3d.hub.pushing import Pushed


def run(
    scene: tyro.conf.Positional[Path],
    to: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="hub:USER/NAME")],
    /,
    licence: str = "",
    public: bool = False,
    json: bool = False,
) -> None:
    """Push a scene to the Hugging Face hub, with a page about it and the hash of each file.

    Its photos go with it, and what it was before its edits: removed objects are still there.
    `instok3d import hub:USER/NAME@COMMIT -o room.itk` takes it from there, and commands that read
    scenes take the name itself. The hub's own tool logs in (`hf auth login`).

    Args:
        scene: A scene folder.
        to: The repository, a data set, which is made where there is none.
        licence: Its identifier on the hub, such as cc-by-4.0; without it the page says that none
            is stated.
        public: Make a new repository one that everybody sees; without it only you do.
        json: Print one JSON object.
    """
    from instok3d.scene.hub_scene import push_scene

    show_pushed(push_scene(scene, to, licence=licence, public=public), json=json)


def show_pushed(pushed: "Pushed", *, json: bool) -> None:
    """Say what the hub has now."""
    from instok3d.cli.info import print_json

    if json:
        print_json({"name": str(pushed.reference), "private": pushed.private,
                    "kept_card": pushed.kept_card})  # fmt: skip
        return
    print(f"{pushed.reference}: {'for you alone' if pushed.private else 'for everybody'}")
    if pushed.kept_card:
        print("note: the page there is somebody's own text and stayed as it was")
