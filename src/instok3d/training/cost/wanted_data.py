"""Which scenes a run needs and what makes them, for a plan without any."""

from instok3d.data.view_sampling import Sampling, frames_needed
from instok3d.training.config import TrainConfig

DATA_SETS: dict[Sampling, tuple[str, str]] = {
    "rooms": ("rendered rooms (1.8 MB each)", "instok3d data rooms -o DIR"),
    "scannet": ("scenes of ScanNet", "instok3d data prepare scannet SCANNET -o DIR"),
    "re10k": ("scenes of RealEstate10K", "instok3d data prepare re10k RE10K -o DIR"),
}
"""By the rule by which a run chooses frames: what it is made for, and the command."""


def wanted_scenes(config: TrainConfig) -> str:
    """What every scene of a run has to be."""
    batches, needs = config.batches, config.stage.data_needs()
    frames = frames_needed(max(batches.views), batches.sampling)
    text = f"{DATA_SETS[batches.sampling][0]} of at least {frames} frames"
    if needs.instances:
        text += f", with masks by {config.masks}" if config.masks else ", with instance ids"
    if needs.depths:
        text += ", with depth"
    return f"{text}; the first {config.holdout} are held out"


def how_to_get_scenes(config: TrainConfig) -> str:
    """The commands that make them."""
    commands = [DATA_SETS[config.batches.sampling][1]]
    if config.masks:
        commands.append(f"instok3d data masks DIR --model {config.masks}")
    text = f"make them by {' and '.join(f'`{command}`' for command in commands)}"
    if config.batches.sampling != "rooms":
        text += " (`data prepare` says with --dry-run what disk that takes)"
    return f"{text} and give --data DIR"
