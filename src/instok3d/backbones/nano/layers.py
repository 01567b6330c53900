"""Layers of the nano backbone: convolutional stem, attention block, upsampling."""

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional


class SelfAttentionBlock(nn.Module):
    """Pre-norm self-attention with normalised queries and keys, then an MLP."""

    def __init__(self, width: int, head_width: int) -> None:
        super().__init__()
        self.head_width = head_width
        self.norm_attention = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width, bias=False)
        self.norm_query = nn.LayerNorm(head_width)
        self.norm_key = nn.LayerNorm(head_width)
        self.project = nn.Linear(width, width)
        self.norm_mlp = nn.LayerNorm(width)
        self.expand = nn.Linear(width, 4 * width)
        self.contract = nn.Linear(4 * width, width)

    def forward(
        self, tokens: Float[Tensor, "sequence token channel"]
    ) -> Float[Tensor, "sequence token channel"]:
        """Tokens after attention and MLP."""
        sequences, count, width = tokens.shape
        mixed = self.query_key_value(self.norm_attention(tokens))
        query, key, value = mixed.view(sequences, count, 3, -1, self.head_width).unbind(2)
        query = self.norm_query(query).to(value.dtype).transpose(1, 2)
        key = self.norm_key(key).to(value.dtype).transpose(1, 2)
        attended = functional.scaled_dot_product_attention(query, key, value.transpose(1, 2))
        tokens = tokens + self.project(attended.transpose(1, 2).reshape(sequences, count, width))
        hidden = functional.gelu(self.expand(self.norm_mlp(tokens)))
        return tokens + self.contract(hidden)


def convolve(channels_in: int, channels_out: int, stride: int = 1) -> nn.Sequential:
    """A 3 x 3 convolution with normalisation and GELU."""
    return nn.Sequential(
        nn.Conv2d(channels_in, channels_out, 3, stride, 1),
        nn.GroupNorm(max(1, channels_out // 16), channels_out),
        nn.GELU(),
    )


class Stem(nn.Module):
    """Images to features at strides 2, 4 and 8."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.stride2 = nn.Sequential(convolve(3, 32, 2), convolve(32, 48))
        self.stride4 = nn.Sequential(convolve(48, 96, 2), convolve(96, 96))
        self.stride8 = nn.Conv2d(96, width, 3, 2, 1)

    def forward(
        self, images: Float[Tensor, "image 3 height width"]
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Features [image, 48, h/2, w/2], [image, 96, h/4, w/4], [image, width, h/8, w/8]."""
        half = self.stride2(images)
        quarter = self.stride4(half)
        return half, quarter, self.stride8(quarter)


class Unshuffle(nn.Module):
    """Doubles the resolution: a linear map to 2x2 sub-positions plus a skip, then a convolution."""

    def __init__(self, channels_in: int, channels_skip: int, channels_out: int) -> None:
        super().__init__()
        self.up = nn.Conv2d(channels_in, 4 * channels_out, 1)
        self.skip = nn.Conv2d(channels_skip, channels_out, 1)
        self.mix = convolve(channels_out, channels_out)

    def forward(
        self,
        coarse: Float[Tensor, "image coarse_channel h w"],
        skip: Float[Tensor, "image skip_channel 2*h 2*w"],
    ) -> Float[Tensor, "image channel 2*h 2*w"]:
        """Features at the resolution of the skip."""
        return self.mix(functional.pixel_shuffle(self.up(coarse), 2) + self.skip(skip))
