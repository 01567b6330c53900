import pytest
import torch

from instok3d.objectives.lpips import Lpips
from instok3d.objectives.rendering import rendering_loss


def test_squared_error_by_hand():
    # Errors 0.1 and 0.3 in equal shares: (0.01 + 0.09) / 2.
    predicted = torch.zeros(2, 3, 4, 4)
    predicted[0], predicted[1] = 0.1, 0.3
    loss = rendering_loss(predicted, torch.zeros(2, 3, 4, 4))
    assert loss.total.item() == pytest.approx(0.05)
    assert loss.lpips.item() == 0


def test_lpips_is_added_with_its_weight(rng):
    torch.manual_seed(0)
    lpips = Lpips("alexnet")
    predicted = torch.rand(1, 2, 3, 64, 64, generator=rng).requires_grad_()
    target = torch.rand(1, 2, 3, 64, 64, generator=rng)
    loss = rendering_loss(predicted, target, lpips=lpips, lpips_weight=0.05)
    assert loss.lpips > 0
    torch.testing.assert_close(loss.total, loss.mse + 0.05 * loss.lpips)
    loss.total.backward()
    assert predicted.grad.isfinite().all()


def test_lpips_without_its_weights_says_what_to_do():
    image = torch.zeros(1, 3, 4, 4)
    with pytest.raises(ValueError, match=r"lpips_weight=0\.05 needs the LPIPS network"):
        rendering_loss(image, image, lpips_weight=0.05)
