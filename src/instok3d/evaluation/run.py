"""Measure a model, and what needs no model, on the scenes of a protocol."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from jaxtyping import Int
from torch import Tensor

from instok3d.data.batches import Unit
from instok3d.data.sample import Sample
from instok3d.evaluation.disturbances import Disturbance, disturbed
from instok3d.evaluation.figures import Figures, summarize
from instok3d.evaluation.id_agreement import id_agreement
from instok3d.evaluation.instance_ap import ApSettings
from instok3d.evaluation.methods import Method
from instok3d.evaluation.object_quality import score_objects
from instok3d.evaluation.prediction import Prediction, predict_by
from instok3d.evaluation.protocols import LEVELS, ProtocolScene
from instok3d.evaluation.scores import SceneScore, ViewScore, score_geometry, score_views
from instok3d.evaluation.simple_baselines import color_masks, nearest_contexts, warped_photos
from instok3d.evaluation.tokenizer_method import GeometryMode, Model, TokenizerMethod
from instok3d.geometry.camera_alignment import TargetCameras
from instok3d.objectives.lpips import Lpips


@dataclass(frozen=True)
class EvaluationSettings:
    """How to measure."""

    geometry: GeometryMode = "predicted"
    """What the model sees beside the photos."""
    target_cameras: Literal["auto", TargetCameras] = "auto"
    """Where targets are rendered. auto: at the true cameras for a model that is given the
    intrinsics and answers in the unit of the scene; brought into the predicted world for others."""
    model_unit: Unit | None = None
    """In which the model answers; None where it learned no unit."""
    pose_alignment_steps: int = 0
    """Steps of test-time pose alignment against the target photo; 0 = none."""
    also_aligned: int = 0
    """The same for a second set of figures beside the first one; 0 = no second set."""
    refine: int = 0
    """Steps of refinement on the context photos; 0 measures the single forward pass."""
    clean_up: bool = False
    """Make whole objects of the groups first; False measures the groups as the model gives them."""
    ap: ApSettings = field(default_factory=lambda: ApSettings(min_instance_area=20))
    """What counts as an instance."""
    alpha_min: float = 0.0
    """Pixels covered no more than this belong to no predicted group."""
    baselines: bool = False
    """Also measure the simple baselines."""
    id_agreement: bool = False
    """Also measure whether views agree on the objects that they show."""
    objects: bool = False
    """Also measure whether each thing is one whole object (`object_quality`)."""
    instances_3d: bool = False
    """Also match groups to the true instances in space (`instances_3d`)."""
    pixels: int | None = None
    """Height at which the model sees the context photos; None: that of the targets."""
    costs: bool = False
    """Also measure the memory that a scene takes, and state all costs first."""
    disturb: Disturbance | None = None
    """What is done to the context photos first; None leaves them as they are."""

    def __post_init__(self):
        if self.geometry == "given" and self.target_cameras == "aligned":
            raise ValueError(
                "given cameras have true targets: leave target_cameras 'aligned' out, or measure "
                "geometry 'predicted' or 'intrinsics'"
            )

    def targets_of(self, scene: ProtocolScene) -> TargetCameras:
        """Where the targets of a scene are rendered; with given cameras always at the true ones."""
        if self.target_cameras != "auto":
            return self.target_cameras
        same_unit = self.geometry == "intrinsics" and self.model_unit == scene.unit
        return "true" if same_unit or self.geometry == "given" else "aligned"


@dataclass(frozen=True)
class EvaluationReport:
    """What was measured and how."""

    protocol: str
    model: str
    settings: EvaluationSettings
    lpips_trunk: str | None
    """Network of LPIPS, None where it was not measured."""
    figures: Figures
    levels: dict[str, Figures]
    """easy, medium and hard rooms alone; each capture alone."""
    baselines: dict[str, Figures]
    scenes: tuple[str, ...]
    """Names; the seeds of rooms."""
    true_targets: int
    """Scenes whose targets were rendered at their true cameras."""
    aligned: "EvaluationReport | None" = None
    """The same scenes, each target camera fitted to its photo (`also_aligned`)."""

    @property
    def of_rooms(self) -> bool:
        """Whether it is of rendered rooms, which have seeds and levels."""
        return self.protocol.startswith("rooms-")

    @property
    def of_captures(self) -> bool:
        """Whether it is of captures, which are reported one by one too."""
        return self.protocol.startswith("capture-")


def evaluate(
    model: Model | Method,
    scenes: Iterable[ProtocolScene],
    settings: EvaluationSettings = EvaluationSettings(),
    *,
    protocol: str,
    model_name: str,
    lpips: Lpips | None = None,
    masks_of: Callable[[Sample], Int[Tensor, "view height width"]] | None = None,
    on_scene: Callable[[ProtocolScene, Sequence[Prediction]], None] | None = None,
) -> EvaluationReport:
    """Measure a model, or any other method, on the scenes of a protocol.

    Args:
        model: Photos in, token groups out, in eval mode; or a method. One that needs cameras is
            measured with settings of geometry 'given'.
        scenes: See `protocols.protocol_rooms` and `dataset_protocols.protocol_scenes`.
        settings: How to measure.
        protocol: Name for the report.
        model_name: Name for the report, best with the hash of the weights.
        lpips: With weights; None leaves LPIPS out.
        masks_of: The id maps of the context views of a sample, for a method that needs masks.
        on_scene: Called after each scene with its predictions, for progress and pictures.

    Raises:
        ValueError: There is no scene; or the settings do not give the cameras that are needed.
    """
    method = _method(model, settings)
    scores: list[SceneScore] = []
    aligned_scores: list[SceneScore] = []
    true_targets = 0
    baselines: dict[str, list[SceneScore]] = {}
    for clean in scenes:
        scene = disturbed(clean, settings.disturb) if settings.disturb else clean
        true_targets += settings.targets_of(scene) == "true"
        score, predictions = score_scene(method, scene, settings, lpips=lpips, masks_of=masks_of)
        scores.append(score)
        aligned = [each.aligned for each in predictions if each.aligned is not None]
        if settings.also_aligned:
            aligned_scores.append(_score_model(scene, aligned, settings, lpips))
        if settings.baselines:
            for name, score in _score_baselines(scene, predictions, settings, lpips).items():
                baselines.setdefault(name, []).append(score)
        if on_scene is not None:
            on_scene(scene, predictions)
    if not scores:
        raise ValueError("evaluate needs at least one scene, got none")
    report = EvaluationReport(
        protocol=protocol,
        model=model_name,
        settings=settings,
        lpips_trunk=None if lpips is None else lpips.trunk,
        figures=summarize(scores),
        levels=_by_level(scores),
        baselines={name: summarize(each) for name, each in baselines.items()},
        scenes=tuple(score.name for score in scores),
        true_targets=true_targets,
    )
    if not aligned_scores:
        return report
    return replace(
        report,
        aligned=replace(
            report,
            settings=replace(settings, pose_alignment_steps=settings.also_aligned, also_aligned=0),
            figures=summarize(aligned_scores),
            levels=_by_level(aligned_scores),
            baselines={},
        ),
    )


def score_scene(
    model: Model | Method,
    scene: ProtocolScene,
    settings: EvaluationSettings,
    *,
    lpips: Lpips | None = None,
    masks_of: Callable[[Sample], Int[Tensor, "view height width"]] | None = None,
) -> tuple[SceneScore, list[Prediction]]:
    """What `evaluate` does with one scene, which is taken as it is: its score, and predictions.

    Raises:
        ValueError: The settings do not give the cameras that the method needs.
    """
    method, targets = _method(model, settings), settings.targets_of(scene)
    predictions = [
        _predict(method, sample, masks_of and masks_of(sample), targets, settings)
        for sample in scene.samples
    ]
    return _score_model(scene, predictions, settings, lpips), predictions


def _by_level(scores: Sequence[SceneScore]) -> dict[str, Figures]:
    """Figures of each level that was measured: LEVELS in their order, others as they come."""
    found = dict.fromkeys(score.level for score in scores if score.level is not None)
    levels = [*(each for each in LEVELS if each in found),
              *(each for each in found if each not in LEVELS)]  # fmt: skip
    return {level: summarize([s for s in scores if s.level == level]) for level in levels}


def _method(model: Model | Method, settings: EvaluationSettings) -> Method:
    """What is measured; a model is the tokenizer, shown what the settings say."""
    if not isinstance(model, Method):
        return TokenizerMethod(
            model,
            settings.geometry,
            settings.refine,
            settings.clean_up,
            settings.alpha_min,
            settings.pixels,
        )
    if "cameras" in model.needs and settings.geometry != "given":
        raise ValueError(
            f"the method needs given cameras, the settings say geometry {settings.geometry!r}"
        )
    return model


def _predict(
    method: Method,
    sample: Sample,
    masks: Int[Tensor, "view height width"] | None,
    targets: TargetCameras,
    settings: EvaluationSettings,
) -> Prediction:
    return predict_by(
        method,
        sample,
        masks=masks,
        target_cameras=targets,
        pose_alignment_steps=settings.pose_alignment_steps,
        with_ids=settings.id_agreement,
        with_objects=settings.objects,
        with_instances_3d=settings.instances_3d,
        with_peak=settings.costs,
        also_aligned=settings.also_aligned,
    )


def _score_model(
    scene: ProtocolScene,
    predictions: Sequence[Prediction],
    settings: EvaluationSettings,
    lpips: Lpips | None,
) -> SceneScore:
    pairs = list(zip(scene.samples, predictions, strict=True))
    views = [
        score_views(
            sample,
            prediction.images,
            prediction.masks,
            settings.ap,
            lpips=lpips,
            images_depth_scaled=prediction.images_depth_scaled,
        )
        for sample, prediction in pairs
    ]
    geometry = ()
    if settings.geometry != "given":
        geometry = tuple(
            score_geometry(sample, each.geometry) for sample, each in pairs if each.geometry
        )
    return SceneScore(
        name=scene.name,
        level=scene.level,
        views=tuple(view for sample_views in views for view in sample_views),
        geometry=geometry,
        groups_used=tuple(
            each.num_groups_used for each in predictions if each.num_groups_used is not None
        ),
        id_agreement=tuple(
            id_agreement(sample, prediction.rendered_ids)
            for sample, prediction in pairs
            if prediction.rendered_ids is not None
        ),
        objects=tuple(
            score_objects(
                sample.context_instances[0],
                prediction.objects,
                min_instance_area=settings.ap.min_instance_area,
            )
            for sample, prediction in pairs
            if prediction.objects is not None
        ),
        instances_3d=tuple(each.instances_3d for each in predictions if each.instances_3d),
        costs=tuple(each.cost for each in predictions),
        picture_s=tuple(each.picture_s for each in predictions),
    )


def _score_baselines(
    scene: ProtocolScene,
    predictions: Sequence[Prediction],
    settings: EvaluationSettings,
    lpips: Lpips | None,
) -> dict[str, SceneScore]:
    views: dict[str, list[ViewScore]] = {}
    for sample, prediction in zip(scene.samples, predictions, strict=True):
        nearest = sample.context.images[0, nearest_contexts(sample)]
        pictures = {"nearest context photo": nearest}
        if prediction.geometry is not None:
            pictures["context photo warped by depth"] = warped_photos(
                sample, prediction.geometry, prediction.cameras
            )
        for name, images in pictures.items():
            scores = score_views(sample, images, None, settings.ap, lpips=lpips)
            views.setdefault(name, []).extend(scores)
        for name, images in (
            ("colour clusters of the target photo", sample.target.images[0]),
            ("colour clusters of the render", prediction.images),
        ):
            masks = [color_masks(image.clamp(0, 1)) for image in images]
            scores = score_views(sample, None, masks, settings.ap)
            views.setdefault(name, []).extend(scores)
    return {name: SceneScore(scene.name, scene.level, tuple(each)) for name, each in views.items()}
