"""SIFT keypoints by pycolmap, matched by their nearest descriptors."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.sfm.colmap import pycolmap_module
from instok3d.sfm.matches import Keypoints, mutual_neighbours

MAX_KEYPOINTS = 4096
"""Of each photo, the largest ones."""


class Sift:
    """Finds and matches keypoints of photos; see `sfm.matches.Features`."""

    def __init__(self) -> None:
        pycolmap = pycolmap_module()
        options = pycolmap.FeatureExtractionOptions()
        options.sift.max_num_features = MAX_KEYPOINTS
        options.num_threads = 1
        options.use_gpu = False
        self.name = f"SIFT of pycolmap {pycolmap.__version__}"
        self.sift = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)

    def find(
        self, image: Float[Tensor, "3 height width"]
    ) -> tuple[Float[Tensor, "point 2"], Float[Tensor, "point channel"]]:
        """Pixels and descriptors; the largest keypoints come first."""
        pycolmap = pycolmap_module()
        grey = (255 * image.mean(dim=0)).round().byte().contiguous().numpy()
        keypoints, descriptors = self.sift.extract(pycolmap.Bitmap.from_array(grey))
        if not keypoints:
            return torch.empty(0, 2), torch.empty(0, 128)
        matrix = torch.from_numpy(pycolmap.keypoints_to_matrix(keypoints).copy()).float()
        vectors = torch.from_numpy(descriptors.data.astype("float32"))
        # pycolmap overshoots the number: whole octaves are dropped.
        largest = matrix[:, 2].argsort(descending=True, stable=True)[:MAX_KEYPOINTS]
        return matrix[largest, :2], torch.nn.functional.normalize(vectors[largest], dim=1)

    def match(self, first: Keypoints, second: Keypoints) -> Int[Tensor, "match 2"]:
        """Mutual neighbours that are nearer than 0.8 times the second nearest (Lowe's ratio)."""
        rows = mutual_neighbours(first.descriptors, second.descriptors)
        if len(second.descriptors) < 2:
            return rows
        similarity = first.descriptors[rows[:, 0]] @ second.descriptors.mT
        nearest, next_one = (2 - 2 * similarity.topk(2, dim=1).values).clamp_min(0).sqrt().T
        return rows[nearest < 0.8 * next_one]
