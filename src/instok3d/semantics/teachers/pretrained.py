"""CLIP, SigLIP 2 and DINO as teachers, through transformers, from local folders of weights.

Their image processors in transformers need torchvision, so images are prepared here: resized to
about as many pixels as the square the model was trained on, with their proportions kept.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.files import sha256_of
from instok3d.reading import naming_damage, number, read_json, reason_of
from instok3d.semantics.teachers.images import IMAGES_AT_ONCE, in_parts, resized, unit
from instok3d.semantics.teachers.texts import check_texts, too_long
from instok3d.transformers_models import (
    REMEDY,
    WEIGHTS,
    check_folder,
    import_transformers,
    load_model,
    quiet,
)

_PROCESSOR, _TOKENIZER = "preprocessor_config.json", "tokenizer.json"
_TOKENIZER_REMEDY = "fetch tokenizer.json and tokenizer_config.json of the same weights into it"
_HALF = (0.5, 0.5, 0.5)
_CLIP_MEAN, _CLIP_STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
_IMAGENET_MEAN, _IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class _PretrainedTeacher(ABC):
    """What the teachers of transformers have in common."""

    KIND: str
    """Begins the name."""
    TYPES: ClassVar[dict[str, str]]
    """Model types of transformers that will do, each with its model class."""
    EXAMPLE: str
    """Weights that will do."""
    MEAN, STD = _IMAGENET_MEAN, _IMAGENET_STD

    def __init__(self, folder: Path, device: torch.device | str = "cpu") -> None:
        """The teacher of a folder with config.json and model.safetensors.

        Raises:
            ModuleNotFoundError: transformers is not installed.
            FileNotFoundError: A file is not there.
            ValueError: The files are damaged, of another model, or do not fit each other.
        """
        transformers = import_transformers(self.KIND)
        self._type = check_folder(folder, [*self.TYPES], self.KIND, self.EXAMPLE)
        self._model = load_model(getattr(transformers, self.TYPES[self._type]), folder, self.KIND)
        self._model.requires_grad_(False).to(device)
        self.device = torch.device(device)
        self.name = f"{self.KIND}-{sha256_of(folder / WEIGHTS)[:12]}"
        self.channels = self._count_channels()
        self._mean, self._std = (
            torch.tensor(each, device=self.device)[:, None, None]
            for each in self._statistics(folder)
        )

    def _statistics(self, folder: Path) -> tuple[list[float], list[float]]:
        """Mean and deviation of the colours: those beside the weights, else the usual ones."""
        found, path = {}, folder / _PROCESSOR
        if path.is_file():
            found = read_json(path, REMEDY)
        with naming_damage(path, REMEDY):
            pairs = (("image_mean", self.MEAN), ("image_std", self.STD))
            mean, std = ([number(each) for each in found.get(key, usual)] for key, usual in pairs)
            if len(mean) != 3 or len(std) != 3 or min(std) <= 0:
                raise ValueError(f"its mean is {mean}, its deviation {std}")
        return mean, std

    def _prepared(self, images: Tensor, side: int, patch: int) -> Tensor:
        """Images of about `side` x `side` pixels in whole patches, normalised."""
        height, width = images.shape[2:]
        scale = side / (height * width) ** 0.5
        sizes = (max(1, round(each * scale / patch)) * patch for each in (height, width))
        return (resized(images, *sizes) - self._mean) / self._std

    @torch.no_grad()
    def features(
        self, images: Float[Tensor, "view 3 height width"]
    ) -> Float[Tensor, "view {self.channels} _rows _columns"]:
        """A unit feature for each patch.

        Args:
            images: sRGB in [0, 1].
        """
        return in_parts(
            lambda part: unit(self._dense(part)), images.to(self.device), IMAGES_AT_ONCE
        )

    @abstractmethod
    def _count_channels(self) -> int: ...

    @abstractmethod
    def _dense(self, images: Tensor) -> Tensor: ...


class DinoTeacher(_PretrainedTeacher):
    """DINOv2 or DINOv3: features of images alone."""

    KIND = "dino"
    TYPES: ClassVar = {
        "dinov2": "Dinov2Model",
        "dinov2_with_registers": "Dinov2WithRegistersModel",
        "dinov3_vit": "DINOv3ViTModel",
    }
    EXAMPLE = "dinov2-base"

    def _count_channels(self) -> int:
        return int(self._model.config.hidden_size)

    def _dense(self, images: Tensor) -> Tensor:
        config = self._model.config
        pixels = self._prepared(images, config.image_size, config.patch_size)
        before = 1 + getattr(config, "num_register_tokens", 0)
        tokens = self._model(pixel_values=pixels).last_hidden_state[:, before:]
        rows = pixels.shape[2] // config.patch_size
        return tokens.mT.unflatten(2, (rows, -1))

    def text(self, texts: Sequence[str]) -> Float[Tensor, "text {self.channels}"]:
        """Nothing: DINO never saw a text.

        Raises:
            ValueError: Always.
        """
        raise ValueError(
            f"{self.name} knows images alone, so it cannot be asked with text: ask it with an "
            "image, or use clip, siglip2 or lseg"
        )

    def crop(self, image: Float[Tensor, "3 height width"]) -> Float[Tensor, " {self.channels}"]:
        """The mean of an image's features, of unit length."""
        return unit(self.features(image[None]).mean(dim=(2, 3)))[0]


class _TextTeacher(_PretrainedTeacher):
    """A teacher with a text encoder, which brings its tokenizer."""

    def __init__(self, folder: Path, device: torch.device | str = "cpu") -> None:
        super().__init__(folder, device)
        if not (folder / _TOKENIZER).is_file():
            raise FileNotFoundError(f"there is no {_TOKENIZER} in {folder}: {_TOKENIZER_REMEDY}")
        transformers = import_transformers(self.KIND)
        try:
            with quiet():
                # Not AutoTokenizer: of some models it overrides what the file says.
                self._tokenizer = transformers.PreTrainedTokenizerFast.from_pretrained(
                    folder, local_files_only=True
                )
        except Exception as error:  # the tokenizer's parser raises nothing more special
            raise ValueError(
                f"{folder / _TOKENIZER} cannot be read ({reason_of(error)}): {_TOKENIZER_REMEDY}"
            ) from error
        if self._tokenizer.pad_token_id is None:
            raise ValueError(f"{folder / _TOKENIZER} pads with nothing: {_TOKENIZER_REMEDY}")

    @property
    def _longest(self) -> int:
        return int(self._model.config.text_config.max_position_embeddings)

    @torch.no_grad()
    def text(self, texts: Sequence[str]) -> Float[Tensor, "text {self.channels}"]:
        """A unit vector for each text, as it stands.

        Raises:
            ValueError: A text is empty or too long.
        """
        check_texts(texts)
        if not texts:
            return torch.zeros(0, self.channels, device=self.device)
        for text, found in zip(texts, self._tokenizer([*texts]).input_ids, strict=True):
            if len(found) > self._longest:
                raise too_long(text, len(found), self._longest)
        return unit(self._embedded([*texts]))

    @abstractmethod
    def _embedded(self, texts: list[str]) -> Tensor: ...


class ClipTeacher(_TextTeacher):
    """CLIP; its dense features are MaskCLIP's (Zhou et al., ECCV 2022).

    The last layer's attention does not mix the patches: each keeps its own value.
    """

    KIND = "clip"
    TYPES: ClassVar = {"clip": "CLIPModel"}
    EXAMPLE = "clip-vit-base-patch16"
    MEAN, STD = _CLIP_MEAN, _CLIP_STD

    def _count_channels(self) -> int:
        return int(self._model.config.projection_dim)

    def _dense(self, images: Tensor) -> Tensor:
        pixels = self._pixels(images)
        encoder = self._model.vision_model
        before = encoder(
            pixel_values=pixels, interpolate_pos_encoding=True, output_hidden_states=True
        ).hidden_states[-2]
        last = encoder.encoder.layers[-1]
        values = last.self_attn.v_proj(last.layer_norm1(before[:, 1:]))
        alone = encoder.post_layernorm(last.self_attn.out_proj(values))
        rows = pixels.shape[2] // self._model.config.vision_config.patch_size
        return self._model.visual_projection(alone).mT.unflatten(2, (rows, -1))

    def _pixels(self, images: Tensor) -> Tensor:
        config = self._model.config.vision_config
        return self._prepared(images, config.image_size, config.patch_size)

    @torch.no_grad()
    def crop(self, image: Float[Tensor, "3 height width"]) -> Float[Tensor, " {self.channels}"]:
        """The vector of a whole image, of unit length."""
        pixels = self._pixels(image[None].to(self.device))
        found = self._model.get_image_features(pixel_values=pixels, interpolate_pos_encoding=True)
        return unit(found.pooler_output)[0]

    def _embedded(self, texts: list[str]) -> Tensor:
        tokens = self._tokenizer(texts, padding=True, return_tensors="pt").to(self.device)
        return self._model.get_text_features(
            input_ids=tokens.input_ids, attention_mask=tokens.attention_mask
        ).pooler_output


class SiglipTeacher(_TextTeacher):
    """SigLIP 2 (and SigLIP); the feature of a patch is what its head makes of that patch alone."""

    KIND = "siglip2"
    TYPES: ClassVar = {"siglip": "SiglipModel", "siglip2": "Siglip2Model"}
    EXAMPLE = "siglip2-base-patch16-224"
    MEAN, STD = _HALF, _HALF

    def _count_channels(self) -> int:
        return int(self._model.config.vision_config.hidden_size)

    def _dense(self, images: Tensor) -> Tensor:
        seen, rows = self._seen(images)
        tokens = seen.last_hidden_state
        alone = self._model.vision_model.head(tokens.flatten(0, 1)[:, None])
        return alone.unflatten(0, tokens.shape[:2]).mT.unflatten(2, (rows, -1))

    def _seen(self, images: Tensor) -> tuple[Any, int]:
        """What the image encoder says, and the number of rows of patches."""
        config, encoder = self._model.config.vision_config, self._model.vision_model
        patch = config.patch_size
        if self._type == "siglip":
            pixels = self._prepared(images, config.image_size, patch)
            rows = pixels.shape[2] // patch
            return encoder(pixel_values=pixels, interpolate_pos_encoding=True), rows
        # Of any proportions ("NaFlex"): patches as rows, with the channels of a pixel together.
        pixels = self._prepared(images, round(config.num_patches**0.5) * patch, patch)
        rows, columns = pixels.shape[2] // patch, pixels.shape[3] // patch
        cut = pixels.unflatten(3, (columns, patch)).unflatten(2, (rows, patch))
        patches = cut.permute(0, 2, 4, 3, 5, 1).flatten(3).flatten(1, 2)
        ones = torch.ones(patches.shape[:2], dtype=torch.int64, device=self.device)
        shapes = torch.tensor([[rows, columns]] * len(images), device=self.device)
        seen = encoder(pixel_values=patches, pixel_attention_mask=ones, spatial_shapes=shapes)
        return seen, rows

    @torch.no_grad()
    def crop(self, image: Float[Tensor, "3 height width"]) -> Float[Tensor, " {self.channels}"]:
        """The vector of a whole image, of unit length."""
        return unit(self._seen(image[None].to(self.device))[0].pooler_output)[0]

    def _embedded(self, texts: list[str]) -> Tensor:
        # As in training: lower case, padded to the full length, the padding not masked.
        lower = [text.lower() for text in texts]
        tokens = self._tokenizer(
            lower, padding="max_length", max_length=self._longest, return_tensors="pt"
        ).to(self.device)
        return self._model.get_text_features(input_ids=tokens.input_ids).pooler_output
