"""The tokenizer: photos in, a scene made of token groups out (Fig. 2a)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

from torch import nn

from instok3d.backbones.base import GeometryBackbone
from instok3d.model.anchors import AnchorDecoder, AnchorPlacement
from instok3d.model.context import ContextFusion
from instok3d.model.gaussian_head import GaussianHead, GaussianHeadConfig
from instok3d.model.grouping import Assignment, GroupDecoder
from instok3d.model.transformer import Decoder
from instok3d.model.views.free_space import prune_free_space
from instok3d.model.views.joining import collate_scenes, join_windows
from instok3d.model.views.windows import cut_window, middle_windows, view_windows
from instok3d.types import Anchors, Context, Geometry, TokenGroups, Views


@dataclass(frozen=True)
class TokenizerConfig:
    """Sizes of the tokenizer. The defaults are the nano model's."""

    width: int = 256
    """C, channels of every token; the paper has 1024 (Sec. 4)."""
    num_anchors: int = 1536
    """K; the paper has 1024 (Sec. 4). Never more than there are patches."""
    num_groups: int = 40
    """L; the paper has 100. Of each window, where there are more views than window_views."""
    window_views: int = 4
    """More views than this are taken in overlapping windows of so many and in pairs, whose groups
    are joined (`model.views.windows`); 0 takes any number at once, as the paper does."""
    anchor_layers: int = 4
    """Layers of D_anchor; the paper has 6."""
    group_layers: int = 3
    """Layers of D_group; the paper has 4."""
    head_size: int = 64
    """Channels of an attention head; 64 as in the paper's backbone."""
    normalize_heads: bool = True
    """Layer-normalise queries and keys in each head; the paper does not say."""
    anchor_self_attention: bool = True
    """Anchors also attend to each other; the paper shows cross-attention alone. What it
    gains in grouping was not measured alone (docs/log.md)."""
    group_self_attention: bool = True
    """Groups also attend to each other, without which two may claim one object; a deviation."""
    normalize_scale: bool = True
    """Divide pointmaps by their mean distance first, and multiply what comes out by it: any unit
    of length will do then, and lengths of the Gaussian head are in that unit. The paper does not:
    its scenes are in metres, and so are the bounds of its Gaussians."""
    pad_duplicates: bool = False
    """Fill up to num_anchors with copies of the first anchor where there are fewer patches, as the
    paper's released scenes do (1,024 anchors of 512 patches: 32,768 Gaussians, half of them
    copies). Off: nothing is lost, from half the Gaussians."""
    project_assignment: bool = True
    """Linear maps of anchors and groups before their dot product (Eq. 3); the paper has none."""
    gaussian_head: GaussianHeadConfig = field(default_factory=GaussianHeadConfig)
    thin_free_space: bool = True
    """Free-space pruning: Gaussians that other views see through lose opacity; not in the paper."""

    def __post_init__(self):
        for name in ("num_anchors", "num_groups", "anchor_layers", "group_layers"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.window_views < 0 or self.window_views == 1:
            raise ValueError(f"window_views must be 0 or at least 2, got {self.window_views}")


PAPER = TokenizerConfig(
    width=1024,
    num_anchors=1024,
    num_groups=100,
    window_views=0,
    anchor_layers=6,
    group_layers=4,
    normalize_heads=False,
    anchor_self_attention=False,
    group_self_attention=False,
    normalize_scale=False,
    project_assignment=False,
    gaussian_head=GaussianHeadConfig(gaussians_per_anchor=32, seeding="anchor", sh_degree=2),
    thin_free_space=False,
)
"""The sizes of the paper (Sec. 4), for a backbone with patches of 16 pixels and scenes in metres:
Gaussians within 0.1 m of their anchor along each axis and no larger than 0.3 m."""


@runtime_checkable
class Lift(Protocol):
    """Gathers features of the patches into the anchors beside D_anchor (Sec. 3.3)."""

    def __call__(self, decoder: Decoder, seeds: Anchors, context: Context) -> Anchors:
        """The anchors as D_anchor decodes them, without a gradient, and what is lifted into them.

        Both in one pass, because they share their attention weights.
        """
        ...

    def cut(self, scene: int, window: Sequence[int]) -> "Lift":
        """The same for one scene's views of a window."""
        ...


class Tokenizer(nn.Module):
    """Photos of a room to a 3D scene made of objects, in one forward pass."""

    def __init__(self, backbone: GeometryBackbone, config: TokenizerConfig):
        super().__init__()
        self.config = config
        self.backbone = backbone
        width = config.width
        self.fuse = ContextFusion(
            backbone.feature_channels,
            width,
            patch_size=backbone.patch_size,
            cells_per_side=config.gaussian_head.cells_per_side,
            normalize_scale=config.normalize_scale,
        )
        self.place = AnchorPlacement(
            width, config.num_anchors, pad_duplicates=config.pad_duplicates
        )
        self.anchor_decoder = AnchorDecoder(
            _decoder(config, config.anchor_layers, config.anchor_self_attention)
        )
        self.group_decoder = GroupDecoder(
            config.num_groups,
            width,
            _decoder(config, config.group_layers, config.group_self_attention),
        )
        self.assign = Assignment(width, project=config.project_assignment)
        self.gaussian_head = GaussianHead(width, config.gaussian_head)

    def forward(
        self, views: Views, geometry: Geometry | None = None, lift: "Lift | None" = None
    ) -> TokenGroups:
        """A scene of each set of photos, in scene units and in the first view's camera frame.

        `tokenize`, and two steps that the paper does not have: more views than window_views are
        tokenized in windows, whose groups are merged; then free-space pruning.

        Args:
            views: 1 to 16 photos of each scene.
            geometry: The backbone's output for these views where it was computed before (it is
                frozen while the tokenizer learns, so its output can be cached).
            lift: Gathers features of the patches into the anchors too (`Anchors.lifted`); nothing
                else changes.

        Raises:
            ValueError: The image size is no multiple of the patch size.
        """
        # F, P: multi-view features and pointmaps
        seen: Geometry = self.backbone(views) if geometry is None else geometry
        size = self.config.window_views
        if size == 0 or views.images.shape[1] <= size:
            groups = self.tokenize(views, seen, lift=lift)
        else:
            groups = self._tokenize_windows(views, seen, size, lift)
        return prune_free_space(groups) if self.config.thin_free_space else groups

    def tokenize(
        self, views: Views, seen: Geometry, *, draw: bool = True, lift: "Lift | None" = None
    ) -> TokenGroups:
        """All views at once, one line for each arrow of Fig. 2(a).

        Positions and Gaussians come out in scene units (the geometry's) and in the first view's
        camera frame. May run under autocast; geometry, softmax and the activations of the
        Gaussians stay in float32. Not differentiable: which patches become anchors.

        Args:
            views: Only the images are used.
            seen: The backbone's output for them.
            draw: Decode Gaussians; otherwise the scene has none.
            lift: See `forward`.
        """
        context = self.fuse(views, seen)  # X: one token per patch of every view
        seeds = self.place(context)  # a, A0: farthest points (Eq. 1)
        if lift is None:
            anchors = self.anchor_decoder(seeds, context)  # A (Eq. 2)
        else:
            anchors = lift(self.anchor_decoder.decoder, seeds, context)
        groups = self.group_decoder(anchors)  # G (Eq. 2)
        assignment = self.assign(anchors.tokens, groups)  # pi (Eq. 3)
        head = self.gaussian_head if draw else self.gaussian_head.no_gaussians
        gaussians = head(anchors, context)  # N_g for each anchor
        scale = context.scale[:, None, None]
        return TokenGroups(
            anchors=replace(anchors, positions=anchors.positions * scale),
            tokens=groups,
            assignment=assignment,
            gaussians=replace(
                gaussians, means=gaussians.means * scale, scales=gaussians.scales * scale
            ),
            geometry=seen,
        )

    def _tokenize_windows(
        self, views: Views, seen: Geometry, size: int, lift: "Lift | None"
    ) -> TokenGroups:
        """Each window of views alone, then the groups of all windows merged."""
        scenes = []
        for scene in range(len(views.images)):
            windows = view_windows(seen, scene, size)
            drawn = set(middle_windows(windows).values())
            parts = []
            for number, window in enumerate(windows):
                kept = number in drawn  # the others say what belongs together, no more
                own_lift = lift.cut(scene, window) if kept and lift is not None else None
                part = self.tokenize(
                    *cut_window(views, seen, scene, window), draw=kept, lift=own_lift
                )
                parts.append(replace(part, geometry=seen))  # frees its copy of the geometry
            scenes.append(join_windows(parts, windows, seen, scene))
        return collate_scenes(scenes, seen)

    def own_parameters(self) -> list[nn.Parameter]:
        """Parameters of everything but the backbone."""
        kept = {id(parameter) for parameter in self.backbone.parameters()}
        return [parameter for parameter in self.parameters() if id(parameter) not in kept]


def _decoder(config: TokenizerConfig, layers: int, self_attention: bool) -> Decoder:
    return Decoder(
        config.width,
        layers,
        self_attention=self_attention,
        head_size=config.head_size,
        normalize_heads=config.normalize_heads,
    )
