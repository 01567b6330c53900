"""What was done to a scene since its source, so that it can be undone, redone, written down."""

from dataclasses import dataclass, fields, replace

from instok3d.scene.edits.operations import Edit, num_invented
from instok3d.scene.record import SceneRecord


@dataclass(frozen=True)
class History:
    """A source and what was done to it. Undoing replays the rest, which is exact."""

    source: SceneRecord
    """The scene before the first of the edits."""
    source_sha256: str
    """Of its gaussians.safetensors."""
    edits: tuple[Edit, ...]
    undone: tuple[Edit, ...]
    """What can be redone, the next one first."""
    current: SceneRecord
    """The source with the edits done."""

    @staticmethod
    def begin(source: SceneRecord, source_sha256: str) -> "History":
        """No edits yet."""
        bare = as_record(source)
        return History(bare, source_sha256, (), (), bare)

    def gives(self, scene: SceneRecord) -> bool:
        """Whether a scene is what the edits give, and not what something else made of that."""
        names = [field.name for field in fields(SceneRecord)]
        return all(getattr(scene, name) is getattr(self.current, name) for name in names)

    def done(self, edit: Edit) -> "History":
        """One more edit; what was undone can no longer be redone.

        Raises:
            KeyError, ValueError: It cannot be done on this scene.
        """
        return replace(
            self, edits=(*self.edits, edit), undone=(), current=self._after(self.current, edit)
        )

    def undo(self) -> "History":
        """Without the last edit.

        Raises:
            ValueError: There is none.
        """
        if not self.edits:
            raise ValueError("there is nothing to undo: the scene has no edits")
        undone = (self.edits[-1], *self.undone)
        return self.replayed(self.edits[:-1], undone)

    def redo(self) -> "History":
        """With the edit that was undone last.

        Raises:
            ValueError: There is none.
        """
        if not self.undone:
            raise ValueError("there is nothing to redo: no edit was undone")
        edit, *rest = self.undone
        return replace(self.done(edit), undone=tuple(rest))

    def replayed(self, edits: tuple[Edit, ...], undone: tuple[Edit, ...]) -> "History":
        """The history with these edits, done one after the other on the source.

        Raises:
            ValueError: One of them cannot be done; says which.
        """
        current = self.source
        for number, edit in enumerate(edits, 1):
            try:
                current = self._after(current, edit)
            except (KeyError, ValueError) as error:
                raise ValueError(
                    f"edit {number} ({edit.name}) cannot be done: {error.args[0]}"
                ) from error
        return replace(self, edits=edits, undone=undone, current=current)

    def _after(self, scene: SceneRecord, edit: Edit) -> SceneRecord:
        made = scene.provenance
        provenance = replace(
            made,
            edits=(*made.edits, edit.words(scene)),
            invented=made.invented + num_invented(edit),
            edited_from=made.edited_from or self.source_sha256,
        )
        return replace(edit.apply(scene), provenance=provenance)


def as_record(scene: SceneRecord) -> SceneRecord:
    """The data of a scene alone, without what `Scene` adds."""
    return SceneRecord(**{field.name: getattr(scene, field.name) for field in fields(SceneRecord)})
