"""Models of the package transformers (`pip install 'instok3d[models]'`) out of local folders."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from instok3d.reading import UNREADABLE, naming_damage, read_json, reason_of, text

WEIGHTS = "model.safetensors"
CONFIG = "config.json"
REMEDY = "fetch it again"


def import_transformers(what: str) -> Any:
    """The package, at version 5 or newer.

    Args:
        what: Needs it; begins the message.

    Raises:
        ModuleNotFoundError: It is not installed.
        ValueError: It is too old.
    """
    try:
        import transformers
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"{what} needs the package transformers; install it with: pip install "
            "'instok3d[models]'"
        ) from error
    if int(transformers.__version__.split(".")[0]) < 5:
        raise ValueError(
            f"transformers {transformers.__version__} is too old; 5 or newer is needed"
        )
    return transformers


def check_folder(folder: Path, kinds: Sequence[str], what: str, example: str) -> str:
    """The model type of a folder of weights; nothing is loaded yet.

    Args:
        folder: Holds config.json and model.safetensors.
        kinds: Model types that will do.
        what: Name of the model, for messages.
        example: Weights that will do.

    Raises:
        FileNotFoundError: One of the two files is not there.
        ValueError: The model is of another type, or the file that says so is damaged.
    """
    for name in (CONFIG, WEIGHTS):
        if not (folder / name).is_file():
            raise FileNotFoundError(
                f"there is no {name} in {folder}; a folder of {what} weights holds {CONFIG} and "
                f"{WEIGHTS}"
            )
    with naming_damage(folder / CONFIG, REMEDY):
        kind = text(read_json(folder / CONFIG, REMEDY)["model_type"])
    if kind not in kinds:
        wanted = " or ".join(map(repr, kinds))
        raise ValueError(
            f"{folder / CONFIG} is of the model type {kind!r}, not {wanted}; give weights such as "
            f"{example}"
        )
    return kind


def load_model(kind: Any, folder: Path, what: str) -> Any:
    """A model in eval mode, on the CPU in float32, whose every weight came from the file.

    Args:
        kind: A model class of transformers.
        folder: Holds config.json and model.safetensors.
        what: Name of the model, for messages.

    Raises:
        ValueError: The files are damaged or do not fit each other.
    """
    import torch
    from huggingface_hub.errors import StrictDataclassError  # a value of another type

    try:
        with quiet():
            model, report = kind.from_pretrained(
                folder,
                local_files_only=True,
                use_safetensors=True,
                dtype=torch.float32,
                output_loading_info=True,
            )
    except (*UNREADABLE, StrictDataclassError) as error:
        raise ValueError(
            f"{folder / WEIGHTS} cannot be read as {what} of the sizes in {CONFIG}: "
            f"{reason_of(error)}; {REMEDY}"
        ) from error
    if report["missing_keys"]:
        raise ValueError(
            f"{folder / WEIGHTS} lacks {len(report['missing_keys'])} weights of {what}, such as "
            f"{sorted(report['missing_keys'])[0]}; fetch it again"
        )
    return model.eval()


@contextmanager
def quiet() -> Iterator[None]:
    """Keep transformers' own bars and reports off the screen; what is wrong is raised here."""
    from transformers.utils import logging

    verbosity, had_bar = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(verbosity)
        if had_bar:
            logging.enable_progress_bar()
