"""SAM 2 and 2.1 through transformers (`pip install 'instok3d[models]'`) as proposer and tracker.

Its processors in transformers need torchvision, so pictures are resized
and normalised here. Every track has a session of its own: tracks can be dropped one by one, and
what SAM 2 no longer looks at is thrown away, so a clip may be of any length.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor
from torch.nn.functional import interpolate

from instok3d.datasets.pseudo_labels.automatic import (
    AutomaticConfig,
    AutomaticMasks,
    PointMasks,
    at_size,
)
from instok3d.datasets.pseudo_labels.interfaces import ProposedMasks, TrackedMask
from instok3d.files import sha256_of
from instok3d.transformers_models import WEIGHTS, check_folder, import_transformers, load_model

WHAT = "SAM 2"
_AUTOMATIC = AutomaticConfig()
_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class Sam2:
    """Both halves of SAM 2 from one folder of weights: a `MaskProposer` and a `MaskTracker`.

    Args:
        folder: Holds config.json (of the kind sam2_video) and model.safetensors.
        automatic: How masks are proposed.
        device: Where the model runs.

    Raises:
        ModuleNotFoundError: transformers is not installed.
        FileNotFoundError: One of the two files is not there.
        ValueError: They are not of SAM 2, do not fit each other, or are damaged.
    """

    def __init__(
        self,
        folder: Path,
        automatic: AutomaticConfig = _AUTOMATIC,
        device: torch.device | str = "cpu",
    ) -> None:
        transformers = import_transformers(WHAT)
        check_folder(folder, ["sam2_video"], WHAT, "sam2.1-hiera-large")
        self.device = torch.device(device)
        self.version: str = transformers.__version__
        self._sha256 = sha256_of(folder / WEIGHTS)
        self._video = load_model(transformers.Sam2VideoModel, folder, WHAT).to(self.device)
        image = _image_model(transformers, self._video)
        self._automatic = AutomaticMasks(_Segmenter(image, self.device), automatic)

    def propose(self, image: UInt8[np.ndarray, "height width 3"]) -> ProposedMasks:
        """Masks of everything in an image."""
        return self._automatic.propose(image)

    def start(self) -> "Sam2Session":
        """A session without frames or tracks."""
        return Sam2Session(self._video, self.device)

    def identity(self) -> dict[str, Any]:
        """What the masks depend on, for the record: library, weights, proposals."""
        return {
            "model": "sam2",
            "weights_sha256": self._sha256,
            "library": f"transformers {self.version}",
            "automatic": asdict(self._automatic.config),
        }


class Sam2Session:
    """A `TrackingSession` of the video model."""

    def __init__(self, model: Any, device: torch.device) -> None:
        from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceCache

        self._model, self._device = model, device
        self._features = Sam2VideoInferenceCache(device, device)  # of the frame, for all tracks
        self._tracks: dict[int, Any] = {}
        self._frame = -1
        self._pixels = torch.zeros(0)
        self._shape = (0, 0)
        self._positions: Tensor | None = None  # of the memory, the same for all

    def step(self, image: UInt8[np.ndarray, "height width 3"]) -> dict[int, TrackedMask]:
        """Track everything into the next frame."""
        self._frame += 1
        self._shape = (image.shape[0], image.shape[1])
        self._pixels = prepared(image, self._size, self._device)[0]
        return {track: self._run(session) for track, session in self._tracks.items()}

    def add(self, masks: Mapping[int, Bool[np.ndarray, "height width"]]) -> None:
        """Begin tracks in the frame of the last step; known ones begin anew."""
        from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession

        for track, mask in masks.items():
            session = Sam2VideoInferenceSession(
                video_height=self._shape[0],
                video_width=self._shape[1],
                inference_device=self._device,
                inference_state_device=self._device,
                video_storage_device=self._device,
                dtype=torch.float32,
            )
            session.cache = self._features
            session.obj_id_to_idx(track)
            session.add_mask_inputs(0, self._frame, mask_prompt(mask, self._size))
            session.obj_with_new_inputs = [track]
            self._tracks[track] = session
            self._run(session)
            session.mask_inputs_per_obj[0].clear()

    def forget(self, tracks: Iterable[int]) -> None:
        """Drop tracks with their memory; unknown ones are none."""
        for track in tracks:
            self._tracks.pop(track, None)

    @property
    def _size(self) -> int:
        return int(self._model.image_size)

    def _run(self, session: Any) -> TrackedMask:
        """One track in the present frame."""
        session.processed_frames = {}  # only the present one is looked at
        output = self._model(session, frame=self._pixels, frame_idx=self._frame)
        self._throw_away(session)
        logits, score = output.pred_masks[0, 0], float(output.object_score_logits.sigmoid())
        if not (np.isfinite(score) and logits.isfinite().all()):
            raise ValueError(
                f"SAM 2 answers frame {self._frame} with values that are not finite; its weights "
                "are damaged"
            )
        return TrackedMask(at_size(logits, self._shape), score)

    def _throw_away(self, session: Any) -> None:
        """Drop from a track's memory what the coming frames will not ask for."""
        config = self._model.config
        outputs = session.output_dict_per_obj[0]
        passed = outputs["non_cond_frame_outputs"]
        for frame in [*passed]:
            age = self._frame - frame
            if age >= max(config.num_maskmem, config.max_object_pointers_in_encoder):
                del passed[frame]
            elif age >= config.num_maskmem:
                passed[frame].pop("maskmem_features", None)
                passed[frame].pop("maskmem_pos_enc", None)
        for output in (*outputs["cond_frame_outputs"].values(), *passed.values()):
            output.pop("high_res_masks", None)
            if "maskmem_pos_enc" in output:
                if self._positions is None:
                    self._positions = output["maskmem_pos_enc"].clone()
                output["maskmem_pos_enc"] = self._positions
        session.frames_tracked_per_obj[0].clear()


class _Segmenter:
    """The image model, asked about points."""

    def __init__(self, model: Any, device: torch.device) -> None:
        self._model, self._device = model, device

    def look_at(
        self, image: UInt8[np.ndarray, "height width 3"]
    ) -> Callable[[Float[Tensor, "point 2"]], PointMasks]:
        """Encode the image; the function that comes back runs the mask decoder alone."""
        size = int(self._model.config.prompt_encoder_config.image_size)
        with torch.inference_mode():
            embeddings = self._model.get_image_embeddings(prepared(image, size, self._device))

        def ask(points: Float[Tensor, "point 2"]) -> PointMasks:
            # The model adds half a pixel to points: it counts from the centre of the first.
            pixels = (points * size - 0.5).to(self._device)[None, :, None]
            with torch.inference_mode():
                output = self._model(
                    image_embeddings=embeddings, input_points=pixels, multimask_output=True
                )
            return PointMasks(output.pred_masks[0], output.iou_scores[0])

        return ask


def prepared(
    image: UInt8[np.ndarray, "height width 3"], size: int, device: torch.device
) -> Float[Tensor, "1 3 size size"]:
    """The image as SAM 2 takes it: stretched to a square with smoothing, then normalised."""
    pixels = torch.from_numpy(np.array(image)).to(device).permute(2, 0, 1)[None].float() / 255
    square = interpolate(pixels, (size, size), mode="bilinear", antialias=True)
    mean, std = torch.tensor(_MEAN, device=device), torch.tensor(_STD, device=device)
    return (square - mean[:, None, None]) / std[:, None, None]


def mask_prompt(
    mask: Bool[np.ndarray, "height width"], size: int
) -> Float[Tensor, "1 1 size size"]:
    """The mask on the model's square, 0 or 1; a mask too thin for it keeps what it touches."""
    whole = torch.from_numpy(np.array(mask)).float()[None, None]
    share = interpolate(whole, (size, size), mode="bilinear", antialias=True)
    inside = share >= 0.5
    return (inside if inside.any() else share > 0).float()


def _image_model(transformers: Any, video: Any) -> Any:
    """The model of single images that is inside the one of videos; they share all weights."""
    config = video.config
    image = transformers.Sam2Model(
        transformers.Sam2Config(
            vision_config=config.vision_config,
            prompt_encoder_config=config.prompt_encoder_config.to_dict(),
            mask_decoder_config=config.mask_decoder_config.to_dict(),
        )
    )
    for part in ("shared_image_embedding", "vision_encoder", "prompt_encoder", "mask_decoder",
                 "no_memory_embedding"):  # fmt: skip
        setattr(image, part, getattr(video, part))
    return image.eval()
