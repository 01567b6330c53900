"""Trains the embedded teacher: text features of every pixel from one photo of a room alone.

    python runs/teacher.py --rooms FOLDER... --table TABLE --start MODEL -o RUN

Rooms with words, the text table, and a model whose nano encoder is where the network starts, or an
earlier teacher. The
run goes on where it stopped; RUN/teacher.safetensors is written at every look at the held-out
rooms (the last 5 % of each folder). The learning rate falls with the time that was used, so that
a run ends well when its --minutes are over; it therefore depends on the machine.

Each step: photos of rooms, those with rare classes more often; a random part of each at random
size, mirrored by chance, with the light and the cameras of the other stages. Two losses on a
quarter of the cells: 1 - cos to the target (class + 1/2 colour + 1/4 material), and cross-entropy
of the cosines with the phrases of all classes, and of all colours, at a temperature.
"""

import argparse
import json
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.data.photometric import photometric_change
from instok3d.data.scenes import SceneFrames
from instok3d.data.sensor import SensorConfig, sensor_change
from instok3d.evaluation.teachers import measure_teacher
from instok3d.files import replacing
from instok3d.rooms.dataset import RoomDataset
from instok3d.rooms.seen_colors import NAMES as COLORS
from instok3d.semantics.classes import PHRASES, ROOM_CLASSES
from instok3d.semantics.predictor import STRIDE, Predictor, PredictorConfig
from instok3d.semantics.targets import target_vectors
from instok3d.semantics.teachers.file import PREFIX, load_teacher, save_teacher
from instok3d.semantics.teachers.rooms import RoomTeacher
from instok3d.semantics.text import TextTable, load_table
from instok3d.training.checkpoint import WeightAverage, read_weights
from instok3d.training.held_out import hold_out_last

TEMPERATURE = 0.04
COLOR_LOSS = 0.3
RARE_SHARE, RARE_POWER, MOST_OFTEN = 0.15, 0.5, 5.0
"""Frames with a class that less than this share of the frames shows are drawn more often."""
CLASS_POWER, WEIGHT_BOUNDS = 0.35, (0.4, 5.0)
"""Pixels of a class weigh its share of all to the power of minus this, within bounds."""
SENSOR = SensorConfig(strength=1.0, probability=0.5)
KEEP = 0.997
"""Of the average of the weights, each step."""
WARM_UP_STEPS, LOG_EVERY = 100, 20


@dataclass(frozen=True)
class Photo:
    """One frame of a room and what its pixels are."""

    image: Float[Tensor, "1 3 height width"]
    classes: Int[Tensor, "height width"]
    """Places in ROOM_CLASSES, -1 without words."""
    colors: Int[Tensor, "height width"]
    """Places in COLORS, -1 without."""
    targets: Int[Tensor, "height width"]
    """Rows of `vectors`, -1 without."""
    vectors: Float[Tensor, "row channel"]


class Frames:
    """Frames of rooms with words, by (room, frame)."""

    def __init__(self, folders: list[Path], table: TextTable) -> None:
        self.rooms = [RoomDataset(folder) for folder in folders]
        self.table = table
        splits = [hold_out_last(len(rooms)) for rooms in self.rooms]
        self.training = [(k, n) for k, split in enumerate(splits) for n in split[0]]
        self.held_out = [(k, n) for k, split in enumerate(splits) for n in split[1]]
        self._vectors: dict[object, Tensor] = {}

    def credits(self) -> list[str]:
        """Whose work the rooms show, one line each."""
        return sorted({line for rooms in self.rooms for line in rooms.credits})

    def photo(self, place: tuple[int, int], frame: int) -> Photo:
        """One frame."""
        scene = self.rooms[place[0]].frames(place[1], [frame])
        words, ids = scene.words, scene.instances[0]
        numbers = sorted(words)
        size = max([0, *numbers, int(ids.max())]) + 2  # the last place is that of -1
        lookup = torch.full((3, size), -1)
        for row, number in enumerate(numbers):
            each = words[number]
            lookup[0, number] = ROOM_CLASSES.index(each.label)
            lookup[1, number] = COLORS.index(each.color) if each.color in COLORS else -1
            lookup[2, number] = row
        for each in words.values():
            if each not in self._vectors:
                self._vectors[each] = target_vectors({1: each}, self.table)[1]
        vectors = [self._vectors[words[number]] for number in numbers]
        classes, colors, targets = lookup[:, ids]
        image = scene.images.permute(0, 3, 1, 2).float() / 255
        return Photo(image, classes, colors, targets, torch.stack(vectors))


def changed(photo: Photo, side: int, rng: np.random.Generator) -> Photo:
    """A random part of a photo at the wanted size, as another camera shows it in other light."""
    image, maps = photo.image, torch.stack([photo.classes, photo.colors, photo.targets])
    none = image[:0]
    image, _ = photometric_change(rng, image, none)
    image, _ = sensor_change(rng, SENSOR, image, none)
    full = image.shape[-1]
    part = round(full * rng.uniform(0.6, 1.0)) if rng.random() < 0.8 else full
    top, left = rng.integers(full - part + 1, size=2)
    image = image[..., top : top + part, left : left + part]
    maps = maps[..., top : top + part, left : left + part]
    if part != side:
        image = functional.interpolate(
            image, (side, side), mode="bilinear", antialias=True, align_corners=False
        )
        maps = functional.interpolate(maps[None].float(), (side, side), mode="nearest")[0].long()
    if rng.random() < 0.5:
        image, maps = image.flip(-1), maps.flip(-1)
    classes, colors, targets = maps
    return Photo(image, classes, colors, targets, photo.vectors)


class Chooser:
    """Draws frames, those with rare classes more often, and weighs the classes of pixels."""

    def __init__(self, frames: Frames) -> None:
        self.places: list[tuple[tuple[int, int], int]] = []
        shown, pixels = [], np.zeros(len(ROOM_CLASSES))
        for place in frames.training:
            records = frames.rooms[place[0]].meta_of(place[1])["instances"]
            counts = np.array([record["pixels"] for record in records])
            labels = np.array([ROOM_CLASSES.index(record["class"]) for record in records])
            for frame in range(counts.shape[1]):
                sums = np.bincount(labels, counts[:, frame], len(ROOM_CLASSES))
                pixels += sums
                shown.append(sums >= 20)
                self.places.append((place, frame))
        present = np.stack(shown)
        share = present.mean(axis=0).clip(1e-6)
        often = ((RARE_SHARE / share) ** RARE_POWER).clip(1, MOST_OFTEN)
        wanted = np.where(present, often, 1).max(axis=1)
        self.chances = wanted / wanted.sum()
        part = pixels / pixels.sum()
        weights = np.where(part > 0, part.clip(1e-9) ** -CLASS_POWER, 0)
        weights /= (weights * part).sum()
        self.weights = torch.from_numpy(weights.clip(*WEIGHT_BOUNDS)).float()

    def draw(self, rng: np.random.Generator, count: int) -> list[tuple[tuple[int, int], int]]:
        """Places of some frames."""
        return [self.places[k] for k in rng.choice(len(self.places), count, p=self.chances)]


def losses(
    features: Float[Tensor, "view channel row column"],
    photos: list[Photo],
    phrases: Float[Tensor, "phrase channel"],
    colors: Float[Tensor, "color channel"],
    weights: Float[Tensor, " phrase"],
    rng: np.random.Generator,
) -> tuple[Tensor, Tensor, Tensor]:
    """Angle to the target, cross-entropy of the classes, and of the colours."""
    row, column = rng.integers(2, size=2)
    cells = features[:, :, row::2, column::2].permute(0, 2, 3, 1).float()
    directions = functional.normalize(cells, dim=-1)
    # The pixel of each cell is one of its four by chance, so that no edge moves on average.
    step = 2 * STRIDE
    rows, columns = (int(start) * STRIDE + int(rng.integers(STRIDE)) for start in (row, column))
    classes, names, targets = (
        torch.stack([getattr(photo, kind)[rows::step, columns::step] for photo in photos])
        for kind in ("classes", "colors", "targets")
    )
    wanted = torch.stack([
        photo.vectors[rows_of.clamp_min(0)] for photo, rows_of in zip(photos, targets, strict=True)
    ])  # fmt: skip
    known = classes >= 0
    pixel_weights = weights[classes.clamp_min(0)] * known
    total = pixel_weights.sum().clamp_min(1e-6)
    angle = (1 - (directions * wanted).sum(dim=-1)) * pixel_weights
    logits = directions @ phrases.T / TEMPERATURE
    named = functional.cross_entropy(logits[known], classes[known], reduction="none")
    named = (named * pixel_weights[known]).sum() / total
    color = functional.cross_entropy(
        (directions @ colors.T / TEMPERATURE).flatten(0, 2), names.flatten(), ignore_index=-1
    )
    return angle.sum() / total, named, color


def held_out_scenes(frames: Frames, per_room: int) -> Iterator[SceneFrames]:
    """Some frames of every held-out room."""
    chosen = np.linspace(0, 15, per_room + 2).round().astype(int)[1:-1].tolist()
    for folder, number in frames.held_out:
        yield frames.rooms[folder].frames(number, chosen)


def main(arguments: list[str] | None = None) -> None:
    """Train, look, save."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--rooms", type=Path, nargs="+", required=True)
    parser.add_argument("--table", type=Path, required=True)
    parser.add_argument("--start", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=60, help="of the whole run")
    parser.add_argument("--small-share", type=float, default=0.6, help="of the run, at 96 pixels")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--lr", type=float, default=6e-4)
    parser.add_argument("--encoder-lr", type=float, default=0.5, help="times --lr")
    parser.add_argument("--frozen", type=int, help="blocks that stay as they are, and the stem")
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--look-every", type=int, default=400)
    parser.add_argument("--threads", type=int, default=1)
    train(parser.parse_args(arguments))


def train(given: argparse.Namespace) -> None:
    """The run of these arguments, from its last checkpoint on."""
    torch.set_num_threads(given.threads)
    torch.manual_seed(given.seed)
    given.output.mkdir(parents=True, exist_ok=True)
    table = load_table(given.table)
    frames = Frames(given.rooms, table)
    chooser = Chooser(frames)
    phrases, colors = table.embed(PHRASES), table.embed(COLORS)
    predictor = Predictor(PredictorConfig(channels=phrases.shape[1]))
    _start(predictor, given.start)
    if given.frozen is not None:
        kept = (predictor.stem, predictor.embed_position, *predictor.blocks[: given.frozen])
        for part in kept:
            part.requires_grad_(False)
    optimizer = torch.optim.AdamW(_parameter_groups(predictor, given), betas=(0.9, 0.98))
    average = WeightAverage(predictor, KEEP)
    step, used_s = _resumed(given.output / "checkpoint.pt", predictor, optimizer, average)
    sums, began = torch.zeros(3), time.monotonic() - used_s
    while (part := (time.monotonic() - began) / (60 * given.minutes)) < 1:
        for group in optimizer.param_groups:
            group["lr"] = group["peak"] * min((step + 1) / WARM_UP_STEPS, _cosine(part))
        rng = np.random.default_rng([given.seed, step])
        side = 96 if part < given.small_share else 128
        photos = [
            changed(frames.photo(*place), side, rng) for place in chooser.draw(rng, given.batch)
        ]
        with torch.autocast("cpu", torch.bfloat16):
            features = predictor(torch.cat([photo.image for photo in photos]))
        parts = losses(features, photos, phrases, colors, chooser.weights, rng)
        (parts[0] + parts[1] + COLOR_LOSS * parts[2]).backward()
        torch.nn.utils.clip_grad_norm_(predictor.parameters(), 2.0)
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        average.update(predictor, step)
        sums += torch.stack([each.detach() for each in parts])
        step += 1
        if step % LOG_EVERY == 0:
            angle, named, color = (sums / LOG_EVERY).tolist()
            sums.zero_()
            _log(given.output, step=step, part=part, angle=angle, classes=named, colors=color)
        if step % given.look_every == 0:
            _report(given, frames, predictor, average, step, per_room=1)
            _save(given.output / "checkpoint.pt", step, time.monotonic() - began, predictor,
                  optimizer, average)  # fmt: skip
    _report(given, frames, predictor, average, step, per_room=4)
    _save(given.output / "checkpoint.pt", step, 60 * given.minutes, predictor, optimizer, average)


def _start(predictor: Predictor, path: Path) -> None:
    """Take the weights of an earlier teacher, or of the encoder of a model."""
    weights = read_weights(path)
    if any(name.startswith(PREFIX) for name in weights):
        predictor.load_state_dict(load_teacher(path).predictor.state_dict())
        return
    predictor.start_from_nano({
        name.removeprefix("backbone."): value.float() for name, value in weights.items()
        if name.startswith("backbone.")
    })  # fmt: skip


def _cosine(part: float) -> float:
    return 0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * part))


def _parameter_groups(predictor: Predictor, given: argparse.Namespace) -> list[dict]:
    encoder = ("stem.", "embed_position.", "blocks.")
    groups: dict[tuple[bool, bool], list] = {}
    for name, parameter in predictor.named_parameters():
        if not parameter.requires_grad:
            continue
        groups.setdefault((name.startswith(encoder), parameter.ndim > 1), []).append(parameter)
    return [
        {"params": parameters, "weight_decay": 0.03 if decays else 0.0,
         "peak": given.lr * (given.encoder_lr if starts else 1.0)}
        for (starts, decays), parameters in groups.items()
    ]  # fmt: skip


def _report(
    given: argparse.Namespace, frames: Frames, predictor: Predictor,
    average: WeightAverage, step: int, *, per_room: int,
) -> None:  # fmt: skip
    """Write the teacher of the averaged weights, and what it says of the held-out rooms."""
    with average.applied(predictor):
        teacher = RoomTeacher(predictor, frames.table, credits=frames.credits())
        save_teacher(teacher, given.output / "teacher.safetensors", overwrite=True)
        quality = measure_teacher(teacher, held_out_scenes(frames, per_room))
    predictor.train()
    rooms, lsm = quality.rooms, quality.lsm
    _log(given.output, step=step, lsm_miou=lsm.mean_iou(), lsm_accuracy=lsm.accuracy(),
         rooms_miou=rooms.mean_iou(), rooms_accuracy=rooms.accuracy())  # fmt: skip
    by_class = {name: round(iou, 2) for name, iou in rooms.ious().items() if iou == iou}
    _log(given.output, **{name: round(iou, 3) for name, iou in lsm.ious().items()}, rooms=by_class)


def _log(folder: Path, **values: object) -> None:
    line = json.dumps({
        name: round(value, 4) if isinstance(value, float) else value
        for name, value in values.items()
    })  # fmt: skip
    print(line, flush=True)
    with (folder / "log.jsonl").open("a") as file:
        file.write(line + "\n")


def _save(
    path: Path, step: int, used_s: float, predictor: Predictor, optimizer: torch.optim.Optimizer,
    average: WeightAverage,
) -> None:  # fmt: skip
    state = {"step": step, "used_s": used_s, "predictor": predictor.state_dict(),
             "optimizer": optimizer.state_dict(), "average": average.values}  # fmt: skip
    with replacing(path) as part:
        torch.save(state, part)


def _resumed(
    path: Path, predictor: Predictor, optimizer: torch.optim.Optimizer, average: WeightAverage
) -> tuple[int, float]:
    """The step and the seconds that were used, and everything else as it was; 0 of a new run."""
    if not path.is_file():
        return 0, 0.0
    state = torch.load(path, weights_only=True)
    predictor.load_state_dict(state["predictor"])
    optimizer.load_state_dict(state["optimizer"])
    average.values = state["average"]
    return state["step"], state["used_s"]


if __name__ == "__main__":
    main()
