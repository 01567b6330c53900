import pytest
import torch

from instok3d.backbones.nano.backbone import NanoBackbone
from instok3d.backbones.nano.network import NanoConfig
from instok3d.semantics.predictor import Predictor, PredictorConfig, classification
from instok3d.types import Views

TINY = PredictorConfig(
    channels=8, width=16, layers=2, head_width=8, quarter_channels=16, half_channels=16
)


@pytest.fixture
def predictor() -> Predictor:
    torch.manual_seed(0)
    return Predictor(TINY).eval()


def test_features_come_at_half_the_size_of_the_photo(predictor: Predictor):
    assert predictor(torch.rand(2, 3, 16, 24)).shape == (2, 8, 8, 12)


def test_views_do_not_see_each_other(predictor: Predictor):
    images = torch.rand(2, 3, 16, 16)
    alone = predictor(images[1:])
    torch.testing.assert_close(predictor(images)[1:], alone, atol=1e-5, rtol=1e-5)


def test_it_starts_as_the_encoder_of_nano(predictor: Predictor):
    """One pair of blocks: the tokens are those that nano has of a single bare photo."""
    torch.manual_seed(1)
    nano = NanoBackbone(NanoConfig(width=16, layers=1, head_width=8, refinement_layers=0)).eval()
    torch.nn.init.normal_(nano.unknown_ray)
    predictor.start_from_nano(nano.state_dict())
    seen = {}
    nano.norm.register_forward_pre_hook(lambda _, inputs: seen.update(nano=inputs[0][..., 16:]))
    predictor.norm.register_forward_pre_hook(lambda _, inputs: seen.update(own=inputs[0]))
    image = torch.rand(1, 3, 16, 24)
    with torch.no_grad():
        nano.encode(Views(image[None]))
        predictor(image)
    torch.testing.assert_close(seen["own"], seen["nano"], atol=1e-5, rtol=1e-5)


def test_a_backbone_of_too_few_blocks_is_no_start(predictor: Predictor):
    with pytest.raises(KeyError):
        predictor.start_from_nano({})


def test_cosines_do_not_depend_on_the_length_of_a_feature():
    features = torch.tensor([3.0, 4.0])[:, None, None]
    found = classification(features, torch.eye(2))
    torch.testing.assert_close(found[:, 0, 0], torch.tensor([0.6, 0.8]))
    torch.testing.assert_close(classification(features * 7, torch.eye(2)), found)


def test_sizes_below_one_are_refused():
    with pytest.raises(ValueError, match="layers must be at least 1, got 0"):
        PredictorConfig(layers=0)
