"""How often a teacher of semantic features is right about the pixels of photos with words.

Every pixel has the class whose phrase is nearest to its feature. LSM's eight classes follow from
that: "other" is what is nearest to a class of the rooms that none of the seven stands for.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.data.scenes import SceneFrames
from instok3d.data.words import ObjectWords
from instok3d.evaluation.confusion import Confusion
from instok3d.semantics.classes import LSM_CLASSES, LSM_OF_ROOM, PHRASES, ROOM_CLASSES, lsm_class
from instok3d.semantics.predictor import classification
from instok3d.semantics.teacher import Teacher


@dataclass(frozen=True)
class SemanticQuality:
    """Against the words of the scenes; pixels of instances without words count nowhere."""

    rooms: Confusion
    """All classes of the rooms; what has another class is left out."""
    lsm: Confusion
    """LSM's eight."""

    def table(self) -> str:
        """Markdown: both means, then the IoU of each class that is true somewhere."""
        lines = [
            "| classes | mIoU | mIoU, mean over pictures | pixel accuracy |",
            "|---|---|---|---|",
        ]
        for name, found in (("LSM-8", self.lsm), ("all classes of rooms", self.rooms)):
            figures = (found.mean_iou(), found.mean_iou_of_images(), found.accuracy())
            lines.append(f"| {name} | {' | '.join(f'{figure:.3f}' for figure in figures)} |")
        for found in (self.lsm, self.rooms):
            lines += ["", "| class | IoU | share of the pixels |", "|---|---|---|"]
            shares = found.counts.sum(dim=1) / found.counts.sum().clamp_min(1)
            for share, (name, iou) in zip(shares.tolist(), found.ious().items(), strict=True):
                if share:
                    lines.append(f"| {name} | {iou:.3f} | {share:.2%} |")
        return "\n".join(lines) + "\n"


def true_classes(
    instances: Int[Tensor, "view height width"], words: Mapping[int, ObjectWords]
) -> Int[Tensor, "kind view height width"]:
    """The class of each pixel in ROOM_CLASSES (row 0) and in LSM_CLASSES (row 1); -1 if unknown.

    A class that the rooms do not have is -1 in the first and "other" in the second.
    """
    ids, places = instances.unique(return_inverse=True)
    found = torch.full((2, len(ids)), -1)
    for place, number in enumerate(ids.tolist()):
        known = words.get(number)
        if known is not None and known.label:
            label = known.label
            found[0, place] = ROOM_CLASSES.index(label) if label in ROOM_CLASSES else -1
            found[1, place] = lsm_class(known.nyu40 or label)
    return found[:, places]


def nearest_class(
    features: Float[Tensor, "view channel row column"],
    phrases: Float[Tensor, "phrase channel"],
    size: tuple[int, int],
) -> Int[Tensor, "view height width"]:
    """The phrase nearest to the feature of each pixel; features are interpolated to the size."""
    whole = functional.interpolate(features.float(), size, mode="bilinear", align_corners=False)
    return classification(whole, phrases).argmax(dim=1)


def measure_teacher(teacher: Teacher, scenes: Iterable[SceneFrames]) -> SemanticQuality:
    """Ask a teacher about each frame of some scenes alone.

    Args:
        teacher: That knows both pictures and texts.
        scenes: With words.

    Raises:
        ValueError: The teacher lacks pictures or texts.
    """
    phrases = teacher.text(PHRASES)
    onto = torch.tensor(LSM_OF_ROOM)
    rooms, lsm = Confusion(ROOM_CLASSES), Confusion(LSM_CLASSES)
    for scene in scenes:
        images = scene.images.permute(0, 3, 1, 2).float() / 255
        size = (images.shape[-2], images.shape[-1])
        for image, in_rooms, in_lsm in zip(
            images, *true_classes(scene.instances, scene.words), strict=True
        ):
            features = teacher.features(image[None])
            found = nearest_class(features, phrases.to(features), size)[0].cpu()
            rooms.add(in_rooms, found)
            lsm.add(in_lsm, onto[found])
    return SemanticQuality(rooms, lsm)
