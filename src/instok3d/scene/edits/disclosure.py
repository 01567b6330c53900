"""A statement, in plain words, of what was edited in a scene."""

from instok3d.scene.record import SceneRecord


def edited_words(scene: SceneRecord) -> str:
    """The line that every export carries; empty where nothing was edited."""
    made = scene.provenance
    if not made.edits:
        return ""
    count = len(made.edits)
    operations = f"{count} operation{'s' * (count != 1)}"
    invented = f", {made.invented} Gaussians invented" if made.invented else ""
    return f"edited: {operations}{invented}, source sha256 {made.edited_from}"


def statement(scene: SceneRecord) -> str:
    """What was edited, for people who see pictures of the scene."""
    made = scene.provenance
    lines = [f"This scene was made by {made.generator} from {_inputs(scene)}."]
    if not made.edits:
        return "\n".join([*lines, "Nothing in it was edited."])
    lines += [
        f"It was edited: {len(made.edits)} operations on the scene whose gaussians.safetensors has "
        f"the SHA-256 {made.edited_from}.",
        "Pictures of it do not show the place as it was photographed.",
        *_invented_words(made.invented),
        *(f"{number}. {words}" for number, words in enumerate(made.edits, 1)),
    ]
    return "\n".join(lines)


def _invented_words(count: int) -> list[str]:
    if not count:
        return []
    return [
        f"{count} of its Gaussians were invented to fill holes that removals left: what they show "
        "continues the surfaces around them, and no photo shows it."
    ]


def _inputs(scene: SceneRecord) -> str:
    count = len(scene.views)
    return f"{count} photo{'s' * (count != 1)}" if count else "an imported file, without photos"
