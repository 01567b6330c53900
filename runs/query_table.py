"""How often questions about test rooms are answered right, by true words and by a teacher.

python runs/query_table.py ROOMS --table TABLE [--teacher FILE] [--objects [--semantics FILE]]
python runs/query_table.py ROOMS... --fit (--objects --semantics FILE | --teacher FILE) [--write]

The first form prints the table of docs/results.md: top 1 / top 3 of each kind of question. --fit
takes the held-out rooms of training folders (`hold_out_last`), fits a calibration on them, prints
it, and with --write keeps it in the file of the semantics (on the objects of scenes) or of the
teacher (on true masks). Thresholds and weights are chosen there alone, never on test rooms, and on
no synonym.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save_file

from instok3d.data.view_sampling import eight_view_protocol, two_view_protocol
from instok3d.data.words import ObjectWords
from instok3d.evaluation.queries import (
    Outcome,
    figures,
    is_a,
    outcome,
    table,
)
from instok3d.evaluation.query_rooms import (
    RoomAnswers,
    RoomTruth,
    by_scene,
    by_teacher,
    by_words,
    mask_vectors,
    room_truth,
    scene_of_photos,
    word_vectors,
)
from instok3d.files import replacing
from instok3d.model.files import load_model
from instok3d.rooms.dataset import RoomDataset
from instok3d.scene.lifting import find_lifting
from instok3d.scene.scene import Scene
from instok3d.semantics.classes import PHRASES
from instok3d.semantics.query.calibration import (
    Calibration,
    fit_logistic,
    fit_scale,
    naming_threshold,
    passing_threshold,
)
from instok3d.semantics.query.encoder import QueryEncoder
from instok3d.semantics.query.grammar import understand
from instok3d.semantics.query.ranking import (
    COLOR_NAMES,
    Ranker,
    class_probabilities,
    similarity,
)
from instok3d.semantics.query.shipped import load_encoder, save_calibration
from instok3d.semantics.teacher import Teacher
from instok3d.semantics.text import load_table
from instok3d.training.held_out import hold_out_last

Rooms = list[RoomTruth]
Answerer = Callable[[RoomTruth], RoomAnswers]
FITTED_KINDS = ("class",)
"""Of questions that the threshold is chosen by: no synonyms, which are for tests."""


class TableTeacher:
    """Texts of a table alone: what true words are compared with."""

    name = "words"

    def __init__(self, file: Path) -> None:
        self.table = load_table(file)
        self.channels = self.table.rows.shape[1]

    def features(self, images: torch.Tensor) -> torch.Tensor:
        """None: words see nothing."""
        raise ValueError("words have no features of photos")

    def text(self, texts: Sequence[str]) -> torch.Tensor:
        """A unit vector for each text."""
        return self.table.embed(texts)

    def crop(self, image: torch.Tensor) -> torch.Tensor:
        """None: words see nothing."""
        raise ValueError("words have no vector of a picture")


def context_frames(views: int, num_frames: int) -> Sequence[int]:
    """The context views of a room."""
    if views == 2:
        return two_view_protocol(num_frames).context
    every = eight_view_protocol(num_frames).context
    return every if views == 8 else every[:: 8 // views]


def read_rooms(folders: Sequence[Path], views: int, *, held_out: bool, scenes: int) -> Rooms:
    """The truth of test rooms, or of the held-out rooms of training folders."""
    found = []
    for folder in folders:
        rooms = RoomDataset(folder)
        numbers = hold_out_last(len(rooms))[1] if held_out else range(min(scenes, len(rooms)))
        for number in numbers:
            frames = context_frames(views, rooms.num_frames(number))
            found.append(room_truth(rooms, number, frames))
    return found


def answers(rooms: Rooms, answerer: Answerer, encoder: QueryEncoder) -> list[Outcome]:
    """Outcomes of all questions of all rooms."""
    found = []
    for room in rooms:
        given = answerer(room)
        ranker = Ranker(given.candidates, encoder.embed, encoder.vocabulary, encoder.calibration)
        for question in room.questions:
            probabilities = ranker.question(understand(question.text))
            found.append(outcome(question, probabilities, given.thing_of))
    return found


def fitted(rooms: Rooms, answerer: Answerer, encoder: QueryEncoder) -> Calibration:
    """The calibration of an encoder by the truth of rooms."""
    known = [labelled(room, answerer(room)) for room in rooms]
    vectors = torch.cat([each.vectors for each in known])
    words = [each for room in known for each in room.words]
    # 1. Scales: the class and the colour of each thing by a softmax over cosines.
    truth = torch.tensor([PHRASES.index(each.label) for each in words])
    class_scale = fit_scale(vectors @ encoder.vocabulary.vectors.T, truth, largest=60.0)
    colored = [row for row, each in enumerate(words) if each.color in COLOR_NAMES]
    colors = torch.tensor([COLOR_NAMES.index(words[row].color) for row in colored])
    color_scale = fit_scale(vectors[colored] @ encoder.embed(COLOR_NAMES).T, colors)
    # 2. Weights: is a thing of the class that is asked for?
    scales = Calibration(class_scale=class_scale, color_scale=color_scale)
    values, meant = examples(known, encoder, scales)
    weights, bias = fit_logistic(values, meant, ridge=1.0)
    score, evidence = weights.tolist()
    first = replace(scales, score_weight=score, evidence_weight=evidence, bias=bias)
    # 3. Thresholds.
    shares = class_probabilities(vectors, encoder.vocabulary, class_scale)
    right = shares.argmax(dim=1) == truth
    label_threshold = naming_threshold(shares.amax(dim=1), right)
    outcomes = answers(rooms, answerer, QueryEncoder(encoder.teacher, first))
    best = torch.tensor([each.best for each in outcomes if each.kind in FITTED_KINDS])
    return replace(first, threshold=passing_threshold(best), label_threshold=label_threshold)


@dataclass(frozen=True)
class Labelled:
    """The objects of a room that show something, and what that is called."""

    vectors: torch.Tensor
    words: tuple[ObjectWords, ...]


def labelled(room: RoomTruth, answered: RoomAnswers) -> Labelled:
    """Embeddings of a room's objects with the words of what they show."""
    shows = [
        (row, room.things[thing].words) for row, thing in enumerate(answered.thing_of) if thing >= 0
    ]
    shows = [(row, words) for row, words in shows if words.label]
    vectors = answered.candidates.vectors[[row for row, _ in shows]]
    return Labelled(vectors, tuple(words for _, words in shows))


def examples(
    known: Sequence[Labelled], encoder: QueryEncoder, scales: Calibration
) -> tuple[torch.Tensor, torch.Tensor]:
    """Score and evidence of every thing for every class, and whether it is one."""
    values, meant = [], []
    for room in known:
        labels = [each.label for each in room.words]
        for name, vector in zip(PHRASES, encoder.vocabulary.vectors, strict=True):
            found = similarity(room.vectors, vector, encoder.vocabulary, scales)
            # A table is neither right nor wrong where a side table is asked for.
            sure = torch.tensor([is_a(each, name) or not is_a(name, each) for each in labels])
            values.append(torch.stack([found.scores, found.evidence], dim=1)[sure])
            meant.append(torch.tensor([is_a(each, name) for each in labels])[sure])
    return torch.cat(values), torch.cat(meant)


def keep(calibration: Calibration, file: Path) -> None:
    """Write the calibration into the metadata of a teacher's file."""
    with safe_open(file, "pt") as opened:
        metadata = opened.metadata() or {}
        tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
    with replacing(file, overwrite=True) as part:
        save_file(tensors, part, {**metadata, **save_calibration(calibration)})


def ways_to_answer(given: argparse.Namespace) -> dict[str, tuple[QueryEncoder, Answerer]]:
    """Encoders and answers by the names of the table's rows."""
    ways: dict[str, tuple[QueryEncoder, Answerer]] = {}
    scenes = Scenes(given.semantics) if given.objects else None
    if given.table is not None:
        words, table = QueryEncoder(TableTeacher(given.table)), load_table(given.table)
        ways["true words, true masks"] = words, lambda room: by_words(room, table)
        if scenes is not None:
            ways["true words, the scene's objects"] = (
                words,
                lambda room: by_scene(
                    room,
                    scenes.of(room),
                    lambda _, things: shown(word_vectors(room, table), things),
                ),
            )
    if given.teacher is not None:
        encoder = load_encoder(given.teacher)
        teacher = encoder.teacher
        ways["teacher, true masks"] = encoder, lambda room: by_teacher(room, teacher)
        if scenes is not None:
            ways["teacher, the scene's objects"] = (
                encoder,
                lambda room: by_scene(
                    room, scenes.of(room), lambda scene, _: seen_by(teacher, room, scene)
                ),
            )
    if scenes is not None and scenes.lifting is not None:
        lifted = scenes.lifting.encoder
        ways["scene"] = (
            lifted,
            lambda room: by_scene(
                room, scenes.of(room), lambda scene, _: lifted_by(lifted.teacher.name, scene)
            ),
        )
    return ways


class Scenes:
    """Scenes of the default model, each made once."""

    def __init__(self, semantics: Path | None) -> None:
        """Load the model, and its semantics where they are given."""
        self._tokenizer = load_model()
        self.lifting = (
            None if semantics is None else find_lifting(semantics, self._tokenizer, default=True)
        )
        self._made: dict[int, Scene] = {}

    def of(self, room: RoomTruth) -> Scene:
        """The scene of a room's context photos."""
        if id(room) not in self._made:
            self._made[id(room)] = scene_of_photos(room.images, self._tokenizer, self.lifting)
        return self._made[id(room)]


def shown(vectors: torch.Tensor, things: Sequence[int]) -> torch.Tensor:
    """The vectors of things; zeros for none."""
    padded = torch.cat([vectors, vectors.new_zeros(1, vectors.shape[1])])
    return padded[list(things)]


def seen_by(teacher: Teacher, room: RoomTruth, scene: Scene) -> torch.Tensor:
    """What a teacher sees where each object of a scene is seen."""
    ids = scene.render(ids=True).ids
    assert ids is not None
    return mask_vectors(room.images, ids, [item.id for item in scene.objects], teacher)


def lifted_by(encoder: str, scene: Scene) -> torch.Tensor:
    """What a scene's own semantics say of its objects."""
    ids = [item.id for item in scene.objects]
    return scene.semantics[encoder].of_objects(ids, scene.tokens.assignment)


def main() -> None:
    """Print the table, or fit the calibration."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("rooms", type=Path, nargs="+")
    parser.add_argument("--table", type=Path)
    parser.add_argument("--teacher", type=Path)
    parser.add_argument("--objects", action="store_true", help="the default model's scenes too")
    parser.add_argument("--semantics", type=Path, help="of the default model, for its scenes")
    parser.add_argument("--views", type=int, choices=(2, 4, 8), default=2)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    if given.table is None and given.teacher is None and given.semantics is None:
        parser.error("give --table, --teacher or --semantics")
    rooms = read_rooms(given.rooms, given.views, held_out=given.fit, scenes=given.scenes)
    encoders = ways_to_answer(given)
    if given.fit:
        # A scene's own semantics are what is asked; a teacher alone has its features on masks.
        kept = {"scene": given.semantics, "teacher, true masks": given.teacher}
        for name, (encoder, answerer) in encoders.items():
            calibration = fitted(rooms, answerer, encoder)
            print(name, json.dumps(calibration.to_json(), indent=1))
            found = answers(rooms, answerer, QueryEncoder(encoder.teacher, calibration))
            print(table({name: figures(found, calibration.threshold)}))
            if given.write and name in kept:
                keep(calibration, kept[name])
        return
    rows = {
        name: figures(answers(rooms, answerer, encoder), encoder.calibration.threshold)
        for name, (encoder, answerer) in encoders.items()
    }
    print(table(rows))


if __name__ == "__main__":
    with torch.no_grad():
        main()
