import torch

from instok3d.backbones.vggt.camera_head import ROUNDS, CameraHead
from tiny_vggt import tiny_vggt


def change(head: CameraHead, tokens: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """What one round adds to a pose, written out."""
    normed = head.token_norm(tokens)
    spread = normed.var(-1, unbiased=False, keepdim=True)
    plain = (normed - normed.mean(-1, keepdim=True)) / (spread + 1e-6).sqrt()
    shift, scale, gate = head.poseLN_modulation(head.embed_pose(known)).chunk(3, dim=-1)
    modulated = gate * (plain * (1 + scale) + shift) + normed
    return head.pose_branch(head.trunk_norm(head.trunk(modulated)))


def published_order(head: CameraHead, tokens: torch.Tensor) -> torch.Tensor:
    """Each round but the first begins by detaching the pose: where it is read and where it is
    added to."""
    pose = change(head, tokens, head.empty_pose_tokens.expand(*tokens.shape[:2], -1))
    for _ in range(ROUNDS - 1):
        pose = pose.detach()
        pose = pose + change(head, tokens, pose)
    return torch.cat([pose[..., :7], pose[..., 7:].relu()], dim=-1)


def test_values_and_gradients_are_those_of_the_published_order(rng):
    head = tiny_vggt().camera_head.double()
    tokens = torch.randn(2, 3, 64, generator=rng, dtype=torch.float64, requires_grad=True)
    weights = torch.randn(2, 3, 9, generator=rng, dtype=torch.float64)
    learned = {name: each for name, each in head.named_parameters() if name != "empty_pose_tokens"}
    wanted = [tokens, *learned.values()]
    found, expected = head(tokens), published_order(head, tokens)
    torch.testing.assert_close(found, expected)
    for name, mine, theirs in zip(
        ["tokens", *learned],
        torch.autograd.grad((found * weights).sum(), wanted),
        torch.autograd.grad((expected * weights).sum(), wanted),
        strict=True,
    ):
        torch.testing.assert_close(mine, theirs, msg=lambda text, name=name: f"{name}: {text}")


def test_the_last_pose_teaches_the_first_nothing(rng):
    head = tiny_vggt().camera_head
    head(torch.randn(1, 3, 64, generator=rng)).sum().backward()
    without = [name for name, each in head.named_parameters() if each.grad is None]
    assert without == ["empty_pose_tokens"]
