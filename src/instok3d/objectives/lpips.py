"""LPIPS, the learned perceptual distance of Zhang et al. (CVPR 2018), version 0.1."""

from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from instok3d.reading import reason_of
from instok3d.weights import weights_path
from instok3d.weights.reading import FETCH_AGAIN, read_weights_file

Trunk = Literal["vgg16", "alexnet"]

TRUNKS: dict[str, Trunk] = {
    "vgg": "vgg16",
    "vgg16": "vgg16",
    "alex": "alexnet",
    "alexnet": "alexnet",
}
"""Networks by the names that papers and packages give them."""

VGG16_STAGES = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))


class Lpips(nn.Module):
    """Distance between images that follows what people call alike; 0 for identical ones.

    Features of a classification network at five depths are normalised along channels; their
    squared differences, weighted by a learned head, are averaged over the image and summed over
    depths. Frozen. VGG16 is what papers report; AlexNet is five times faster.

    The parameters mean nothing until weights are loaded: see `load_lpips`.
    """

    shift: Tensor
    spread: Tensor

    def __init__(self, trunk: Trunk):
        super().__init__()
        self.trunk = trunk
        self.stages = _vgg16() if trunk == "vgg16" else _alexnet()
        widths = [
            [layer.out_channels for layer in stage.modules() if isinstance(layer, nn.Conv2d)][-1]
            for stage in self.stages
        ]
        self.heads = nn.ParameterList(nn.Parameter(torch.rand(width)) for width in widths)
        shift = torch.tensor([-0.030, -0.088, -0.188])
        spread = torch.tensor([0.458, 0.448, 0.450])
        self.register_buffer("shift", shift[:, None, None], persistent=False)
        self.register_buffer("spread", spread[:, None, None], persistent=False)
        self.requires_grad_(False)
        self.eval()

    def forward(
        self,
        first: Float[Tensor, "image 3 height width"],
        second: Float[Tensor, "image 3 height width"],
    ) -> Float[Tensor, " image"]:
        """Distance of each pair of images in [0, 1].

        The network runs in the autocast type where that is on, the differences in float32.
        """
        total = torch.zeros(len(first), device=first.device)
        first, second = self._normalized(first), self._normalized(second)
        for stage, head in zip(self.stages, self.heads, strict=True):
            first, second = stage(first), stage(second)
            difference = (_unit(first) - _unit(second)).square()
            total = total + (difference * head[:, None, None]).sum(dim=1).mean(dim=(1, 2))
        return total

    def _normalized(
        self, images: Float[Tensor, "image 3 height width"]
    ) -> Float[Tensor, "image 3 height width"]:
        images = (2 * images - 1 - self.shift) / self.spread
        return images.to(memory_format=torch.channels_last)


def _unit(
    features: Float[Tensor, "image channel height width"],
) -> Float[Tensor, "image channel height width"]:
    features = features.float()
    # The square root has no finite gradient at 0, which whole columns of features do reach.
    length = (features.square().sum(dim=1, keepdim=True) + 1e-20).sqrt()
    return features / (length + 1e-10)


def load_lpips(weights: Path | str) -> Lpips:
    """LPIPS with the published weights of a network, or with those of a file.

    Args:
        weights: vgg16 (vgg) or alexnet (alex): what `instok3d models pull lpips` fetched. Else a
            safetensors file that `convert_lpips` wrote.

    Raises:
        MissingWeightsError: The published weights are not on this machine; says how to get them.
        FileNotFoundError: There is no such file.
        ValueError: The file is not one of LPIPS weights.
    """
    name = TRUNKS.get(str(weights))
    path = Path(weights) if name is None else weights_path(f"lpips-{name}")
    if not path.is_file():
        raise FileNotFoundError(
            f"no LPIPS weights at {path}: give a file, or {' or '.join(TRUNKS)} after "
            "'instok3d models pull lpips'"
        )
    state, metadata = read_weights_file(path, FETCH_AGAIN)
    trunk = metadata.get("lpips_trunk")
    if trunk not in ("vgg16", "alexnet"):
        raise ValueError(
            f"{path} does not hold LPIPS weights: its lpips_trunk is {trunk!r}, "
            "wanted 'vgg16' or 'alexnet'"
        )
    model = Lpips(trunk)
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(
            f"{path} does not fit the {trunk} trunk of LPIPS: {reason_of(error)}; {FETCH_AGAIN}"
        ) from error
    return model


def _vgg16() -> nn.ModuleList:
    stages, channels = nn.ModuleList(), 3
    for index, widths in enumerate(VGG16_STAGES):
        layers: list[nn.Module] = [nn.MaxPool2d(2)] if index else []
        for width in widths:
            layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU()]
            channels = width
        stages.append(nn.Sequential(*layers))
    return stages


def _alexnet() -> nn.ModuleList:
    return nn.ModuleList(
        [
            nn.Sequential(nn.Conv2d(3, 64, 11, stride=4, padding=2), nn.ReLU()),
            nn.Sequential(nn.MaxPool2d(3, 2), nn.Conv2d(64, 192, 5, padding=2), nn.ReLU()),
            nn.Sequential(nn.MaxPool2d(3, 2), nn.Conv2d(192, 384, 3, padding=1), nn.ReLU()),
            nn.Sequential(nn.Conv2d(384, 256, 3, padding=1), nn.ReLU()),
            nn.Sequential(nn.Conv2d(256, 256, 3, padding=1), nn.ReLU()),
        ]
    )
