"""A geometry backbone small enough to train on two CPU cores.

Convolutional stem, alternating frame and global attention as in VGGT (Sec. 3.1 of the paper), a
depth head, and dense descriptors whose matches give the relative cameras: a camera that is solved
for from matches is learned far faster than one that is regressed from a token. With the cameras
known, the matches say in turn what the depth should have been.
"""

from dataclasses import dataclass, replace
from math import pi

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.base import BackboneConfig, GeometryBackbone, Prediction, settle_geometry
from instok3d.backbones.nano.bundle import BundleNoise, SolveSettings
from instok3d.backbones.nano.depth_agreement import agree_on_depths
from instok3d.backbones.nano.layers import SelfAttentionBlock, Stem, Unshuffle
from instok3d.backbones.nano.matching import MATCH_STRIDE, find_peaks
from instok3d.backbones.nano.pair_cameras import (
    align_pairs,
    improve_views,
    solve_views,
    unsolved,
)
from instok3d.backbones.nano.pair_matches import PairMatches, PhotoViews, scale_focal
from instok3d.backbones.nano.refinement import DepthRefinement, gather_evidence
from instok3d.backbones.nano.threads import one_thread
from instok3d.geometry.cameras import (
    intrinsics_from_field_of_view,
    pixel_centers,
    pixel_rays,
)
from instok3d.geometry.registration import best_loops, spanning_tree
from instok3d.types import Geometry, Views

AT_FIRST, AFTER_REFINEMENT = BundleNoise(), BundleNoise(depth=0.05)
"""Refined depth is less wrong than what the network says at first."""
QUARTER_CHANNELS = 64
"""Of the decoder's features at a quarter of the image's size."""


@dataclass(frozen=True)
class NanoConfig(BackboneConfig):
    """Sizes of the nano backbone."""

    width: int = 256
    """Channels of a token."""
    layers: int = 4
    """Pairs of a frame block and a global block (VGGT: 24)."""
    head_width: int = 64
    """Channels of an attention head; 32 is twice as slow on a CPU."""
    match_channels: int = 64
    """Channels of a descriptor."""
    refinement_layers: int = 2
    """Attention blocks of the refinement of depth by parallax; 0 = none of it."""
    typical_field_of_view_rad: float = 1.05
    """What an image of unknown intrinsics is taken for before the focal head corrects it."""

    def __post_init__(self):
        for name in ("width", "layers", "head_width", "match_channels"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.refinement_layers < 0:
            raise ValueError(f"refinement_layers must be at least 0, got {self.refinement_layers}")
        if not 0 < self.typical_field_of_view_rad < pi:
            raise ValueError(
                "typical_field_of_view_rad must be above 0 and below pi, got "
                f"{self.typical_field_of_view_rad}"
            )


@dataclass(frozen=True)
class RawGeometry:
    """What the network itself says, before cameras are solved for: the input of the losses."""

    features: Float[Tensor, "batch view patch channel"]
    log_depths: Float[Tensor, "batch view height width"]
    log_confidences: Float[Tensor, "batch view height width"]
    descriptors: Float[Tensor, "batch view cell match_channel"]
    """Unit length, one for each MATCH_STRIDE x MATCH_STRIDE cell, row-major."""
    log_focal: Float[Tensor, "batch view"]
    """Logarithm of predicted over typical focal length."""
    quarter: Float[Tensor, "image quarter_channel row column"]
    """The decoder's features, one for each cell; all views of all scenes in a row."""


@dataclass(frozen=True)
class RefinedDepth:
    """Depth and its confidence after the refinement, and the cameras that it came from."""

    log_depths: Float[Tensor, "batch view height width"]
    log_confidences: Float[Tensor, "batch view height width"]
    cam_from_first: Float[Tensor, "batch view 4 4"]
    """Solved before the refinement, in its units; not differentiable."""
    intrinsics: Float[Tensor, "batch view 3 3"]
    """With the focal length that was solved for, where it was a guess."""


@dataclass(frozen=True)
class ComparedPhotos:
    """Output of the network and pairwise matches: all that is known before cameras are solved."""

    raw: RawGeometry
    pairs: list[PairMatches]


class NanoBackbone(GeometryBackbone):
    """Features, depth and cameras of 1 to 16 views of any size that is a multiple of 8 pixels."""

    patch_size = 8

    def __init__(self, config: NanoConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.feature_channels = 2 * width
        self.stem = Stem(width)
        self.embed_position = nn.Linear(16, width)
        self.embed_ray = nn.Linear(2, width)
        self.unknown_ray = nn.Parameter(torch.zeros(width))
        self.frame_blocks = nn.ModuleList(
            SelfAttentionBlock(width, config.head_width) for _ in range(config.layers)
        )
        self.global_blocks = nn.ModuleList(
            SelfAttentionBlock(width, config.head_width) for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(2 * width)
        self.to_coarse_depth = nn.Linear(2 * width, 2)
        self.to_quarter = Unshuffle(2 * width, 96, QUARTER_CHANNELS)
        self.to_half = Unshuffle(QUARTER_CHANNELS, 48, 32)
        self.to_fine_depth = nn.Conv2d(32, 8, 1)
        self.to_descriptor = nn.Conv2d(QUARTER_CHANNELS, config.match_channels, 1)
        self.log_sharpness = nn.Parameter(torch.tensor(2.5))
        self.no_match_cosine = nn.Parameter(torch.tensor(0.8))
        self.to_focal = nn.Sequential(nn.Linear(2 * width, width), nn.GELU(), nn.Linear(width, 1))
        self.refinement = None
        if config.refinement_layers:
            self.refinement = DepthRefinement(
                width, config.head_width, config.refinement_layers, QUARTER_CHANNELS
            )
        nn.init.normal_(self.to_coarse_depth.weight, std=0.01)
        nn.init.normal_(self.to_fine_depth.weight, std=0.01)
        for parameter in self.to_focal[2].parameters():
            nn.init.zeros_(parameter)

    def encode(self, views: Views) -> RawGeometry:
        """Run the network: everything that is learned, nothing that is solved."""
        batch, count, _, height, width = views.images.shape
        if height % self.patch_size or width % self.patch_size:
            raise ValueError(
                f"images are {height}x{width} pixels; the nano backbone needs multiples of "
                f"{self.patch_size}: resize or pad them"
            )
        images = views.images.flatten(0, 1) * 2 - 1
        half, quarter, eighth = self.stem(images.contiguous(memory_format=torch.channels_last))
        rows, columns = eighth.shape[-2:]
        frame = tokens = eighth.flatten(2).mT + self._positions(views, rows, columns)
        for frame_block, global_block in zip(self.frame_blocks, self.global_blocks, strict=True):
            frame = frame_block(tokens)
            tokens = global_block(frame.view(batch, count * rows * columns, -1)).view_as(frame)
        features = self.norm(torch.cat([frame, tokens], dim=-1))
        grid = features.mT.unflatten(2, (rows, columns))
        quarter = self.to_quarter(grid, quarter)
        fine = functional.pixel_shuffle(self.to_fine_depth(self.to_half(quarter, half)), 2)
        coarse = self.to_coarse_depth(features).mT.unflatten(2, (rows, columns))
        coarse = functional.interpolate(
            coarse.float(), size=(height, width), mode="bilinear", align_corners=False
        )
        depth = coarse + fine.float()
        descriptors = self.to_descriptor(quarter).flatten(2).mT.float()
        split = (batch, count)
        return RawGeometry(
            features=features.unflatten(0, split),
            log_depths=depth[:, 0].clamp(-4, 4).unflatten(0, split),
            log_confidences=depth[:, 1].clamp(-4, 6).unflatten(0, split),
            descriptors=functional.normalize(descriptors, dim=-1).unflatten(0, split),
            log_focal=self.to_focal(features.mean(1)).float().squeeze(-1).unflatten(0, split),
            quarter=quarter,
        )

    def match(
        self,
        descriptors_a: Float[Tensor, "batch cell channel"],
        descriptors_b: Float[Tensor, "batch other channel"],
    ) -> tuple[Float[Tensor, "batch cell other"], Float[Tensor, "batch cell"]]:
        """Logits of each cell of a to lie at each cell of b, and the logarithm of their total.

        The total includes one more outcome, "not seen in b", whose logit is no_match(): the
        probabilities exp(logit - total) sum to less than 1.
        """
        logits = descriptors_a @ descriptors_b.mT * self.log_sharpness.exp()
        return logits, torch.logaddexp(logits.logsumexp(dim=-1), self.no_match())

    def no_match(self) -> Float[Tensor, ""]:
        """Logit of "not seen": that of a cell of one learned cosine, times the cells it beats."""
        return self.log_sharpness.exp() * self.no_match_cosine + 4.0

    def compare(self, views: Views) -> ComparedPhotos:
        """Encodes the photos and matches them in pairs, without solving for cameras."""
        raw = self.encode(views)
        with torch.autocast(views.images.device.type, enabled=False):
            return ComparedPhotos(raw, self.find_matches(raw))

    def forward(self, views: Views, compared: ComparedPhotos | None = None) -> Geometry:
        """Geometry of the views; depth and cameras that are given are kept, the rest is solved.

        Predicted depth is in units of about the scene's mean depth. Where cameras or depth are
        given, the units are theirs. The solved cameras are not differentiable.

        Args:
            views: 1 to 16 photos of each scene.
            compared: Result of `compare` for these views, if it has been computed already.
        """
        raw = self.encode(views) if compared is None else compared.raw
        known = torch.zeros_like(raw.log_depths, dtype=torch.bool)
        if views.depths is not None:
            known = views.depths > 0
        keep_cameras = views.cam_from_world is not None and views.depths is not None
        with torch.autocast(views.images.device.type, enabled=False):
            intrinsics = self.intrinsics(views, raw)
            solved_for = not (known.all() and keep_cameras)
            if compared is not None:
                matches = compared.pairs
            else:
                matches = self.find_matches(raw) if solved_for else []
        refined = None
        log_depths, log_confidences = raw.log_depths.float(), raw.log_confidences.float()
        if not known.all():
            refined = self.refine(raw, views, intrinsics, matches)
            log_depths, log_confidences = refined.log_depths, refined.log_confidences
        with torch.autocast(views.images.device.type, enabled=False):
            depths = log_depths.exp()
            if views.depths is not None:
                depths = _fill_unknown(views.depths, depths)
            if views.cam_from_world is not None and keep_cameras:
                cam_from_world = views.cam_from_world.float()
            else:
                free = (~known).all(-1).all(-1).float()
                settings = SolveSettings(free, views.intrinsics is None, AFTER_REFINEMENT)
                posed = PhotoViews(views.images.float(), depths, intrinsics)
                if refined is None or known.any():
                    solved = solve_views(matches, posed, settings)
                else:
                    posed = replace(posed, intrinsics=refined.intrinsics)
                    solved = improve_views(
                        matches,
                        posed,
                        unsolved(posed, refined.cam_from_first),
                        replace(settings, focal_is_free=False),
                    )
                intrinsics = scale_focal(posed.intrinsics, solved.log_focal)
                cam_from_world = solved.cam_from_first
            # Confidences are from 1 upwards, as the heads of the published models give them.
            confidences = 1 + log_confidences.exp()
            if not known.all():
                change = agree_on_depths(depths, confidences, cam_from_world, intrinsics)
                depths = torch.where(known, depths, depths * change.exp())
        prediction = Prediction(
            features=raw.features,
            depths=depths,
            confidences=confidences,
            cam_from_world=cam_from_world,
            intrinsics=intrinsics,
        )
        return settle_geometry(views, prediction)

    def refine(
        self,
        raw: RawGeometry,
        photos: Views,
        intrinsics: Float[Tensor, "batch view 3 3"],
        matches: list[PairMatches],
    ) -> RefinedDepth:
        """Depth moved to where the matches put it: coarsely with the cameras, then by the network.

        Differentiable in the weights of the refinement and in the depth and confidence that it
        corrects, not in what it looks at.

        Args:
            raw: What the network says of the photos.
            photos: With intrinsics where they are known; otherwise the focal length is solved for.
            intrinsics: The known ones, or those that `intrinsics` predicts.
            matches: As `find_matches` gives them.
        """
        log_depths, log_confidences = raw.log_depths.float(), raw.log_confidences.float()
        with torch.autocast(log_depths.device.type, enabled=False), torch.no_grad():
            views = PhotoViews(photos.images.float(), log_depths.exp(), intrinsics)
            free = torch.ones_like(views.depths[..., 0, 0])
            settings = SolveSettings(free, photos.intrinsics is None, AT_FIRST)
            solved = solve_views(matches, views, settings)
            views = views.moved(solved)
        log_depths = log_depths + solved.deeper
        if self.refinement is not None:
            with torch.autocast(log_depths.device.type, enabled=False), torch.no_grad():
                aligned = align_pairs(matches, views, solved.cam_from_first)
                evidence = gather_evidence(aligned, views, solved.cam_from_first)
            deeper, surer = self.refinement(
                evidence,
                log_depths.detach(),
                log_confidences.detach(),
                raw.features.detach(),
                raw.quarter.detach(),
            )
            log_depths, log_confidences = log_depths + deeper, log_confidences + surer
        return RefinedDepth(
            log_depths.clamp(-4, 4),
            log_confidences.clamp(-4, 6),
            solved.cam_from_first,
            views.intrinsics,
        )

    def intrinsics(self, views: Views, raw: RawGeometry) -> Float[Tensor, "batch view 3 3"]:
        """The given intrinsics, or predicted ones with the principal point in the middle."""
        if views.intrinsics is not None:
            return views.intrinsics.float()
        height, width = views.images.shape[-2:]
        typical = torch.tensor(self.config.typical_field_of_view_rad)
        base = intrinsics_from_field_of_view(typical, max(height, width), max(height, width))
        result = base.to(raw.log_focal).expand(*raw.log_focal.shape, 3, 3).clone()
        result[..., 0, 0] = result[..., 0, 0] * raw.log_focal.exp()
        result[..., 1, 1] = result[..., 1, 1] * raw.log_focal.exp()
        result[..., 0, 2], result[..., 1, 2] = 0.5 * width, 0.5 * height
        return result

    @torch.no_grad()
    def find_matches(self, raw: RawGeometry) -> list[PairMatches]:
        """Matches along each scene's tree of best matches, and of as many more pairs as views.

        With two views there is one pair, with three or four there are all.
        """
        tables = self.overlap_scores(raw)
        trees = [spanning_tree(table) for table in tables]
        edges = [
            tree + best_loops(table, tree, len(table))
            for table, tree in zip(tables, trees, strict=True)
        ]
        return self._match_pairs(raw, edges)

    def _match_pairs(
        self, raw: RawGeometry, edges_of_scenes: list[list[tuple[int, int]]]
    ) -> list[PairMatches]:
        """The n-th pairs of all scenes together; every scene has equally many."""
        scenes = torch.arange(len(edges_of_scenes), device=raw.descriptors.device)
        columns = raw.log_depths.shape[-1] // MATCH_STRIDE
        found = []
        for edges in zip(*edges_of_scenes, strict=True):
            views_a, views_b = torch.tensor(edges, device=scenes.device).unbind(-1)
            logits, total_a = self.match(
                raw.descriptors[scenes, views_a], raw.descriptors[scenes, views_b]
            )
            total_b = torch.logaddexp(logits.logsumexp(dim=1), self.no_match())
            of_a = find_peaks(logits, total_a, columns)
            of_b = find_peaks(logits.mT, total_b, columns)
            found.append(PairMatches(views_a, views_b, of_a, of_b))
        return found

    @one_thread()
    @torch.no_grad()
    def overlap_scores(self, raw: RawGeometry) -> Float[Tensor, "batch view view"]:
        """Share of a view's cells that are seen in another view, from every 17th cell.

        17 shares no factor with the usual numbers of columns, so the cells spread evenly.
        """
        queries = raw.descriptors[:, :, ::17]
        batch, count = queries.shape[:2]
        scores = torch.zeros(batch, count, count)
        for a in range(count):
            for b in range(count):
                if a != b:
                    _, total = self.match(queries[:, a], raw.descriptors[:, b])
                    seen = 1 - (self.no_match() - total).exp()
                    scores[:, a, b] = seen.mean(-1).cpu()
        return scores

    def _positions(self, views: Views, rows: int, columns: int) -> Tensor:
        """Embedding of where each patch lies in its image and, if known, of its viewing ray."""
        height, width = views.images.shape[-2:]
        centers = pixel_centers(rows, columns, like=views.images) * self.patch_size
        middle = torch.tensor([0.5 * width, 0.5 * height], device=views.images.device)
        relative = (centers - middle) / (0.5 * max(height, width))
        waves = [relative * (torch.pi / 2) * 2**octave for octave in range(4)]
        position = torch.cat([f(wave) for wave in waves for f in (torch.sin, torch.cos)], dim=-1)
        embedding = self.embed_position(position.flatten(0, 1))[None]
        if views.intrinsics is None:
            return embedding + self.unknown_ray
        scaled = views.intrinsics.flatten(0, 1).float().clone()
        scaled[:, :2] = scaled[:, :2] / self.patch_size
        rays = pixel_rays(scaled, rows, columns)[..., :2]
        return embedding + self.embed_ray(rays.flatten(1, 2))


def _fill_unknown(given: Tensor, predicted: Tensor) -> Tensor:
    """Given depth, with holes filled by predicted depth brought to its scale (median ratio)."""
    scenes = []
    for given_scene, predicted_scene in zip(given.float(), predicted, strict=True):
        known = given_scene > 0
        if not known.any():
            scenes.append(predicted_scene)
            continue
        scale = (given_scene[known] / predicted_scene[known]).median()
        scenes.append(torch.where(known, given_scene, predicted_scene * scale))
    return torch.stack(scenes)
