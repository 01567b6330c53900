"""Texts and pictures in the space of a library's encoder."""

import numpy as np
from jaxtyping import Float
from torch import Tensor

from instok3d.library.entries import Encoder, check_encoder
from instok3d.semantics.teacher import Teacher


def library_teacher(encoder: Encoder, library: object, given: str | None) -> Teacher:
    """What turns questions into embeddings of a library's encoder.

    Args:
        encoder: Of the library.
        library: Its place, for messages.
        given: As `open_teacher` takes it; None takes the encoder that comes with this package.

    Raises:
        ValueError: It is another encoder than the library's, or one is needed and none was given.
        FileNotFoundError: There are no such weights.
    """
    from instok3d.semantics.query.shipped import shipped_encoder
    from instok3d.semantics.teachers import FORMS, open_teacher

    if given is not None:
        asked = open_teacher(given)
        check_encoder(encoder, Encoder(asked.name, asked.channels), library)
        return asked
    shipped = shipped_encoder([encoder.name])
    if shipped is None:
        raise ValueError(
            f"{library} holds features of {encoder.name!r}: name its weights with --teacher, one "
            f"of {', '.join(FORMS)}"
        )
    return shipped.teacher


def text_embedding(teacher: Teacher, text: str) -> Float[np.ndarray, " channel"]:
    """What a text means.

    Raises:
        ValueError: It is empty, or the encoder knows nothing of it.
    """
    if not text.strip():
        raise ValueError("the text is empty: describe what to look for")
    return teacher.text([text])[0].cpu().numpy()


def picture_embedding(
    teacher: Teacher, image: Float[Tensor, "3 height width"]
) -> Float[np.ndarray, " channel"]:
    """What a picture of one thing shows.

    Raises:
        ValueError: The encoder takes no pictures.
    """
    return teacher.crop(image).cpu().numpy()
