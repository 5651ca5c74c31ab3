"""Rollouts in PyTorch; skipped where it is not installed."""

import pytest

torch = pytest.importorskip("torch")

import whirls.torch  # noqa: E402
from conftest import small  # noqa: E402


def start(scene):
    return tuple(torch.from_numpy(x).requires_grad_() for x in scene.initial_state())


def test_torch_finds_the_gradients_right(scene):
    run = whirls.torch.rollout(scene, steps=4, every=2)
    c = torch.tensor(8.0, dtype=torch.float64, requires_grad=True)

    def frames(c, r0, v0):
        return tuple(torch.sin(x) for x in run({"c": c, "alpha": 0.5}, r0, v0))

    assert torch.autograd.gradcheck(frames, (c, *start(scene)), eps=1e-6, atol=1e-6, rtol=1e-6, fast_mode=True)


def test_the_operators_are_what_torch_takes_them_for():
    scene = small("inverse-2d")
    run = whirls.torch.rollout(scene, steps=2)
    seen = []
    operator = whirls.torch._forward
    try:
        whirls.torch._forward = lambda *arguments: seen.append(arguments) or operator(*arguments)
        run({"c": torch.tensor(8.0, dtype=torch.float64, requires_grad=True)}, *start(scene))
    finally:
        whirls.torch._forward = operator
    found = torch.library.opcheck(operator, seen[0])
    assert set(found.values()) == {"SUCCESS"}, found


def test_weights_have_gradients_as_one_tensor():
    scene = small("rot-inv-2d")
    weights = torch.from_numpy(scene.weights()).requires_grad_()
    _, v = whirls.torch.rollout(scene, steps=2)({"weights": weights}, *start(scene))
    (v[-1] ** 2).mean().backward()
    run = whirls.rollout(scene, steps=2)
    cotangent = run.v * 0.0
    cotangent[-1] = 2 * run.v[-1] / run.v[-1].size
    torch.testing.assert_close(weights.grad, torch.from_numpy(run.vjp(v=cotangent)[0]["weights"]), rtol=1e-9, atol=0.0)
