import json

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from instok3d.baselines.segmenter import Segmenter, SegmenterConfig
from instok3d.baselines.segmenter_file import load_segmenter, save_segmenter
from instok3d.errors import MissingWeightsError
from instok3d.semantics.predictor import PredictorConfig

SIZES = PredictorConfig(16, 16, 1, 16, quarter_channels=16, half_channels=16)
PHOTOS = torch.rand(2, 3, 32, 48, generator=torch.Generator().manual_seed(1))


def made(seed: int = 0) -> Segmenter:
    torch.manual_seed(seed)
    return Segmenter(SegmenterConfig(SIZES, num_queries=3, decoder_layers=1)).eval()


class Fixed(Segmenter):
    """Answers with given shares."""

    def __init__(self, shares: torch.Tensor) -> None:
        super().__init__(SegmenterConfig(SIZES, num_queries=3, decoder_layers=1))
        self.shares = shares

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        return self.shares


def test_every_pixel_is_shared_among_the_queries_and_the_void():
    shares = made()(PHOTOS)
    assert shares.shape == (2, 4, 32, 48)
    torch.testing.assert_close(shares.sum(dim=1), torch.ones(2, 32, 48))
    assert (shares >= 0).all()


def test_a_photo_is_segmented_without_regard_to_others():
    model = made()
    torch.testing.assert_close(model(PHOTOS)[:1], model(PHOTOS[:1]))


def test_masks_are_numbered_anew_in_each_photo_and_the_void_has_none():
    winners = torch.tensor([[[1] * 6 + [3] * 6] * 4, [[0] * 6 + [2] * 5 + [1]] * 4])
    shares = 0.7 * torch.nn.functional.one_hot(winners, 4).movedim(-1, 1) + 0.1
    model = Fixed(shares)
    ids = model.masks(torch.zeros(2, 3, 4, 12))
    assert ids[0, 0].tolist() == [1] * 6 + [0] * 6
    assert ids[1, 0].tolist() == [1] * 6 + [2] * 5 + [0]  # 4 pixels are too few for a mask
    found = model.found(torch.zeros(2, 3, 4, 12))[0]
    assert found.ids[0].tolist() == [1] * 6 + [0] * 6  # by the rule of AP the void takes nothing
    assert found.scores[1] == pytest.approx(0.8)


def test_no_photo_gives_no_mask():
    assert made().masks(PHOTOS[:0]).shape == (0, 32, 48)


def test_a_file_gives_the_same_network(tmp_path):
    file = tmp_path / "segmenter.safetensors"
    model = made()
    save_segmenter(model, file, card={"steps": 7}, half=False)
    again = load_segmenter(file)
    assert torch.equal(again(PHOTOS), model(PHOTOS))
    assert not again.training
    with safe_open(file, framework="pt") as stream:
        assert json.loads(stream.metadata()["card"]) == {"steps": 7}
    save_segmenter(model, file, card={})
    torch.testing.assert_close(load_segmenter(file)(PHOTOS), model(PHOTOS), atol=5e-3, rtol=0)


def test_files_that_are_no_segmenter_are_refused(tmp_path):
    file = tmp_path / "segmenter.safetensors"
    with pytest.raises(MissingWeightsError, match=r"no segmenter .*; train one"):
        load_segmenter(file)
    save_file({"a": torch.zeros(1)}, file)
    with pytest.raises(ValueError, match=r"segmenter\.safetensors is damaged .*instok3d-segmenter"):
        load_segmenter(file)
    save_segmenter(made(), file, card={})
    with safe_open(file, framework="pt") as stream:
        metadata = stream.metadata()
    weights = load_file(file)
    save_file(weights | {"queries": weights["queries"][:2]}, file, metadata)
    with pytest.raises(ValueError, match=r"queries has the shape \(2, 16\), wanted \(3, 16\)"):
        load_segmenter(file)
    save_file(weights | {"queries": weights["queries"] * torch.nan}, file, metadata)
    with pytest.raises(ValueError, match="weight queries is not finite"):
        load_segmenter(file)
    broken = made()
    broken.queries.data[0, 0] = torch.nan
    with pytest.raises(ValueError, match="weight queries is not finite in float16"):
        save_segmenter(broken, tmp_path / "none.safetensors", card={})
    assert not (tmp_path / "none.safetensors").exists()


@pytest.mark.parametrize(
    ("sizes", "told"),
    [
        ({"num_queries": 0}, "num_queries must be at least 1, got 0"),
        ({"decoder_layers": 0}, "decoder_layers must be at least 1, got 0"),
        ({"predictor": PredictorConfig(channels=64)}, "must be equal, got 64 and 256"),
    ],
)
def test_sizes_that_make_no_network_are_refused(sizes, told):
    with pytest.raises(ValueError, match=told):
        SegmenterConfig(**sizes)
