"""Several data sets as one."""

from collections.abc import Sequence

from instok3d.data.scenes import SceneFrames, SceneSource


class JoinedScenes:
    """The scenes of several sources in turn: the first of each, then the second of each, and on.

    So the first scenes, which a run holds out, are of all of them.
    """

    def __init__(self, sources: Sequence[SceneSource]):
        """Join the sources; they are read where they are.

        Raises:
            ValueError: No source, or two scenes have one name, by which runs know them.
        """
        if not sources:
            raise ValueError("no data set to join: give at least one")
        self._sources = tuple(sources)
        longest = max(len(source) for source in sources)
        self._places = [
            (source, number)
            for number in range(longest)
            for source in self._sources
            if number < len(source)
        ]
        self.credits = sorted(
            {line for source in self._sources for line in getattr(source, "credits", ())}
        )
        """Whose work the pictures show, one line each."""
        seen: set[str] = set()
        for source, number in self._places:
            name = source.name_of(number)
            if name in seen:
                raise ValueError(
                    f"two of the data sets have a scene {name!r}, and runs know scenes by their "
                    "names; make one of them with other seeds, or leave it out"
                )
            seen.add(name)

    def __len__(self) -> int:
        return len(self._places)

    def name_of(self, number: int) -> str:
        """The name of the scene in its own data set."""
        source, own = self._places[number]
        return source.name_of(own)

    def num_frames(self, number: int) -> int:
        """How many frames scene `number` has."""
        source, own = self._places[number]
        return source.num_frames(own)

    def frames(self, number: int, chosen: Sequence[int]) -> SceneFrames:
        """These frames of scene `number` in this order."""
        source, own = self._places[number]
        return source.frames(own, chosen)
