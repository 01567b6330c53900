"""A geometry backbone small enough to train on two CPU cores.

The network (network.py) predicts depth, focal length and dense descriptors. Cameras are not
regressed but solved for, from matches between the descriptors: that takes far less training. With
the cameras known, the parallax of the matches corrects the depth.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.backbones.base import Prediction, settle_geometry
from instok3d.backbones.nano.bundle_problem import BundleNoise, SolveSettings
from instok3d.backbones.nano.depth_agreement import agree_on_depths
from instok3d.backbones.nano.matching import MATCH_STRIDE, find_peaks
from instok3d.backbones.nano.network import NanoConfig as NanoConfig
from instok3d.backbones.nano.network import NanoNetwork, RawGeometry
from instok3d.backbones.nano.pair_cameras import (
    align_pairs,
    improve_views,
    initial_solution,
    match_support,
    solve_views,
)
from instok3d.backbones.nano.pair_matches import PairMatches, PhotoViews, scale_focal
from instok3d.backbones.nano.refinement import gather_evidence
from instok3d.backbones.nano.threads import one_thread
from instok3d.geometry.cameras import intrinsics_from_field_of_view
from instok3d.geometry.registration import best_loops, spanning_tree
from instok3d.types import Geometry, Views

BEFORE_REFINEMENT, AFTER_REFINEMENT = BundleNoise(), BundleNoise(depth=0.05)
"""Expected errors; refined depth is more accurate."""


@dataclass(frozen=True)
class RefinedDepth:
    """Refined depth and its confidence, with the cameras that it was computed from."""

    log_depths: Float[Tensor, "batch view height width"]
    log_confidences: Float[Tensor, "batch view height width"]
    cam_from_first: Float[Tensor, "batch view 4 4"]
    """Solved before the refinement, in units of the unrefined depth; not differentiable."""
    intrinsics: Float[Tensor, "batch view 3 3"]
    """With the solved focal length where it was unknown."""


@dataclass(frozen=True)
class ComparedPhotos:
    """Output of the network and pairwise matches: all that is known before cameras are solved."""

    raw: RawGeometry
    pairs: list[PairMatches]


class NanoBackbone(NanoNetwork):
    """Features, depth and cameras of 1 to 16 views of any size that is a multiple of 8 pixels."""

    def compare(self, views: Views) -> ComparedPhotos:
        """Encode the photos and match them in pairs, without solving for cameras."""
        raw = self.encode(views)
        with torch.autocast(views.images.device.type, enabled=False):
            return ComparedPhotos(raw, self.find_matches(raw))

    def forward(self, views: Views, compared: ComparedPhotos | None = None) -> Geometry:
        """Geometry of the views; given depth and cameras are kept.

        1. Encode the photos and match them in pairs.
        2. Where depth is unknown, refine the predicted depth by the parallax of the matches.
        3. Solve for the cameras, unless cameras and depth are given.
        4. Bring the predicted depths of the same surface in different views together.

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
                        initial_solution(posed, refined.cam_from_first),
                        replace(settings, focal_is_free=False),
                    )
                intrinsics = scale_focal(posed.intrinsics, solved.log_focal)
                cam_from_world = solved.cam_from_first
            # Confidences start at 1, as those of the published models.
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

    @torch.no_grad()
    def support(
        self, views: Views, compared: ComparedPhotos, geometry: Geometry
    ) -> Float[Tensor, " batch"]:
        """Robust number of matches that fit a geometry, to compare geometries of the same photos.

        Not differentiable.

        Args:
            views: The photos, as the geometry took them.
            compared: Their matches.
            geometry: Of these photos.
        """
        cameras = geometry.cameras
        posed = PhotoViews(views.images.float(), geometry.depths, cameras.intrinsics)
        solved = initial_solution(posed, cameras.cam_from_world)
        return match_support(compared.pairs, posed, solved, AFTER_REFINEMENT)

    def refine(
        self,
        raw: RawGeometry,
        photos: Views,
        intrinsics: Float[Tensor, "batch view 3 3"],
        matches: list[PairMatches],
    ) -> RefinedDepth:
        """Depth corrected by the matches: coarsely by bundle adjustment, then by the network.

        Differentiable in the weights of the refinement and in the depth and confidence that it
        corrects, not in its inputs.

        Args:
            raw: Output of the network.
            photos: With intrinsics where they are known; otherwise the focal length is solved for.
            intrinsics: Known intrinsics, or those that `intrinsics` predicts.
            matches: Output of `find_matches`.
        """
        log_depths, log_confidences = raw.log_depths.float(), raw.log_confidences.float()
        with torch.autocast(log_depths.device.type, enabled=False), torch.no_grad():
            views = PhotoViews(photos.images.float(), log_depths.exp(), intrinsics)
            free = torch.ones_like(views.depths[..., 0, 0])
            settings = SolveSettings(free, photos.intrinsics is None, BEFORE_REFINEMENT)
            solved = solve_views(matches, views, settings)
            views = views.corrected(solved)
        log_depths = log_depths + solved.log_depth_correction
        if self.refinement is not None:
            with torch.autocast(log_depths.device.type, enabled=False), torch.no_grad():
                aligned = align_pairs(matches, views, solved.cam_from_first)
                evidence = gather_evidence(aligned, views, solved.cam_from_first)
            depth_correction, confidence_correction = self.refinement(
                evidence,
                log_depths.detach(),
                log_confidences.detach(),
                raw.features.detach(),
                raw.quarter.detach(),
            )
            log_depths = log_depths + depth_correction
            log_confidences = log_confidences + confidence_correction
        return RefinedDepth(
            log_depths.clamp(-4, 4),
            log_confidences.clamp(-4, 6),
            solved.cam_from_first,
            views.intrinsics,
        )

    def intrinsics(self, views: Views, raw: RawGeometry) -> Float[Tensor, "batch view 3 3"]:
        """Given intrinsics, or predicted ones with the principal point at the image centre."""
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
        """Matches along each scene's spanning tree of overlap, and of as many more pairs as views.

        Two views have one pair; of three or four views all pairs are matched.
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
        """Matches of the n-th pairs of all scenes in one batch; every scene has as many pairs."""
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
        """Expected share of a view's cells that are visible in another view, from every 17th cell.

        17 is coprime to the usual numbers of columns, so that the sampled cells spread evenly.
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


def _fill_unknown(given: Tensor, predicted: Tensor) -> Tensor:
    """Given depth, with holes filled by predicted depth at its scale (median of the ratios)."""
    scenes = []
    for given_scene, predicted_scene in zip(given.float(), predicted, strict=True):
        known = given_scene > 0
        if not known.any():
            scenes.append(predicted_scene)
            continue
        scale = (given_scene[known] / predicted_scene[known]).median()
        scenes.append(torch.where(known, given_scene, predicted_scene * scale))
    return torch.stack(scenes)
