"""What `instok3d evaluate --method` measures."""

from dataclasses import dataclass
from pathlib import Path

from instok3d.baselines.context_masks import RULE, MasksOf, MaskSource, Tracker, context_masks
from instok3d.baselines.feature_files import FeatureMethodName, load_feature_model
from instok3d.baselines.feature_method import FeatureMethod
from instok3d.baselines.registry import METHODS, MethodName
from instok3d.baselines.segmenter_file import load_segmenter
from instok3d.baselines.settings import SplatSettings
from instok3d.evaluation.methods import Method
from instok3d.evaluation.tokenizer_method import GeometryMode, Model
from instok3d.files import sha256_of
from instok3d.model.files import DEFAULT_MODEL, load_model, read_card


@dataclass(frozen=True)
class Measured:
    """A method with its name in the report."""

    method: Model | Method
    name: str
    seed: int | None
    """Of its training or optimisation; None where nobody knows."""
    masks_of: MasksOf | None = None
    """For a method that needs masks."""


def measured_model(model: Path | None) -> Measured:
    """The tokenizer of a file, None for the default model.

    Raises:
        FileNotFoundError, ValueError: See `load_model`.
    """
    file = DEFAULT_MODEL if model is None else model
    tokenizer = load_model(model)
    seed = read_card(model).get("config", {}).get("seed")
    return Measured(tokenizer, f"{file.name} sha256:{sha256_of(file)[:12]}", seed)


@dataclass(frozen=True)
class GivenMasks:
    """Where masks of the context views come from; None is the rule."""

    source: MaskSource | None
    tracker: Tracker | None
    model: Path | None
    """Whose geometry the tracker predicted-depth takes."""
    segmenter: Path | None = None
    """File of the network that the source segmenter asks."""

    @property
    def settled_source(self) -> MaskSource:
        """The source, or the rule."""
        return self.source or "true"

    @property
    def settled_tracker(self) -> Tracker:
        """The tracker, or the rule for the source."""
        return self.tracker or RULE[self.settled_source]


def given_masks_of(source: str | None, tracker: Tracker | None, model: Path | None) -> GivenMasks:
    """As --masks, --tracker and --model say it.

    Raises:
        ValueError: The source is none of the known ones.
    """
    kind, _, file = (source or "").partition(":")
    if kind == "segmenter" and file:
        return GivenMasks("segmenter", tracker, model, Path(file))
    if source not in (None, "true", "degraded"):
        raise ValueError(f"--masks must be true, degraded or segmenter:FILE, got {source!r}")
    return GivenMasks(source, tracker, model)


def measured_method(name: MethodName, steps: int | None, masks: GivenMasks) -> Measured:
    """A method that optimises each scene.

    Args:
        name: Of the method.
        steps: Of the optimisation; None takes those of the method.
        masks: That it is given, if it needs any.

    Raises:
        ValueError: No such number of steps can be done, masks are named that are not needed, or
            they cannot be made so.
        MissingWeightsError: There is no such segmenter.
    """
    settings = SplatSettings() if steps is None else SplatSettings(steps=steps)
    method = METHODS[name](settings)
    title = f"{name}, {settings.steps} steps"
    if "masks" not in method.needs:
        if masks.source is not None or masks.tracker is not None:
            raise ValueError(f"--method {name} needs no masks: leave --masks and --tracker out")
        return Measured(method, title, settings.seed)
    source, tracker = masks.settled_source, masks.settled_tracker
    model = load_model(masks.model) if tracker == "predicted-depth" else None
    segmenter = None if masks.segmenter is None else load_segmenter(masks.segmenter)
    masks_of = context_masks(
        source, tracker, geometry_of=model and model.backbone,
        segment=segmenter and segmenter.masks, seed=settings.seed,
    )  # fmt: skip
    given = f"masks {source}"
    if masks.segmenter is not None:
        given = f"{given} {masks.segmenter.name} sha256:{sha256_of(masks.segmenter)[:12]}"
    title = f"{title}, {given}, tracker {tracker}"
    if model is not None:
        title += f" of {(masks.model or DEFAULT_MODEL).name}"
    return Measured(method, title, settings.seed, masks_of)


def measured_features(
    name: FeatureMethodName, model: Path | None, geometry: GeometryMode
) -> Measured:
    """A model that gives each Gaussian a feature, in one pass.

    Args:
        name: Of its method.
        model: Its file.
        geometry: What of the context views it sees.

    Raises:
        MissingWeightsError: There is no such file.
        ValueError: The file is damaged or of another method.
    """
    assert model is not None
    network = load_feature_model(model, name)
    return Measured(
        FeatureMethod(network, geometry),
        f"{name} {model.name} sha256:{sha256_of(model)[:12]}",
        None,
    )


def check_one_pass(name: FeatureMethodName, model: Path | None, given: dict[str, bool]) -> None:
    """Refuse what a model without instances cannot follow.

    Args:
        name: Of its method.
        model: Its file.
        given: Options that are of the tokenizer alone, and whether each was given.

    Raises:
        ValueError: Says what, and what to do.
    """
    if model is None:
        raise ValueError(
            f"--method {name} needs --model FILE: instok3d train nano-{name}, then train export"
        )
    wrong = [option for option, is_given in given.items() if is_given]
    if wrong:
        raise ValueError(f"{wrong[0]} is of the tokenizer; leave it out with --method {name}")


def check_options(name: MethodName, protocol: str, given: dict[str, bool]) -> None:
    """Refuse what a method that optimises each scene cannot follow.

    Args:
        name: Of the method.
        protocol: Of the evaluation.
        given: Options that are of the tokenizer alone, and whether each was given.

    Raises:
        ValueError: Says which, and what to do.
    """
    if not protocol.startswith(("rooms-", "scannet-")):
        raise ValueError(
            f"--method {name} needs cameras, depth and masks, which {protocol} does not have; "
            "choose a protocol of rooms or ScanNet"
        )
    wrong = [option for option, is_given in given.items() if is_given]
    if wrong:
        raise ValueError(
            f"{wrong[0]} is of the tokenizer; leave it out with --method {name}, which optimises "
            "each scene from given cameras and depth"
        )
