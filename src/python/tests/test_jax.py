"""Rollouts in JAX."""

import numpy as np
import pytest

jax = pytest.importorskip("jax")
import jax.numpy as jnp  # noqa: E402
from jax.test_util import check_grads  # noqa: E402

import whirls  # noqa: E402
import whirls.jax  # noqa: E402
from conftest import small  # noqa: E402

POINT = {"c": 8.0, "alpha": 0.5}


@pytest.fixture(autouse=True)
def double_precision():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", True)


def losses(scene):
    """A loss over all frames by both kinds of rollout."""
    def of(run):
        def loss(parameters, r0, v0):
            r, v = run(parameters, r0, v0)
            return jnp.sum(jnp.sin(r[1:])) / r.size + jnp.mean(v**2)

        return loss

    runs = (make(scene, steps=4, every=2) for make in (whirls.jax.rollout, whirls.jax.rollout_jvp))
    return [of(run) for run in runs]


def test_jax_finds_its_gradients_right(scene):
    reverse, forward = losses(scene)
    point = (POINT, *scene.initial_state())
    check_grads(reverse, point, order=1, modes=["rev"], atol=1e-6, rtol=1e-6, eps=1e-5)
    check_grads(forward, point, order=1, modes=["fwd"], atol=1e-6, rtol=1e-6, eps=1e-5)


def test_jit_and_vmap_give_the_same_bits_and_both_modes_agree(scene):
    reverse, forward = losses(scene)
    start = scene.initial_state()
    by = jax.grad(reverse)(POINT, *start)
    assert jax.jit(jax.grad(reverse))(POINT, *start) == by
    along = jax.jacfwd(forward)(POINT, *start)
    for name in POINT:
        np.testing.assert_allclose(along[name], by[name], rtol=1e-12)
    speeds = jnp.array([8.0, 9.0])
    slope = jax.grad(lambda c: reverse({"c": c}, *start))
    assert jax.vmap(slope)(speeds).tolist() == [float(slope(c)) for c in speeds]


def test_a_jacobian_of_residuals_is_one_run_and_the_right_one(scene, monkeypatch):
    start = scene.initial_state()
    run = whirls.jax.rollout_jvp(scene, steps=4, every=2)
    runs = []
    own = whirls.jax._Plan.run
    monkeypatch.setattr(whirls.jax._Plan, "run", lambda *given: runs.append(1) or own(*given))
    names = ["c", "alpha", "gamma"]
    residuals = lambda x: run(dict(zip(names, x)), *start)[1]  # noqa: E731
    x = jnp.array([8.0, 0.5, 5.0])
    jacobian = jax.jacfwd(residuals)(x)
    assert len(runs) == 2
    assert jacobian.shape == (*run({}, *start)[1].shape, 3)
    for k in range(3):
        one = jax.jvp(residuals, (x,), (jnp.eye(3)[k],))[1]
        np.testing.assert_allclose(jacobian[..., k], one, rtol=1e-12, atol=1e-13)
    points = jnp.stack([x, 1.1 * x])
    several = jax.vmap(jax.jacfwd(residuals))(points)
    np.testing.assert_allclose(several[0], jacobian, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(several[1], jax.jacfwd(residuals)(points[1]), rtol=1e-12, atol=1e-13)


def test_weights_have_gradients_as_one_array():
    scene = small("rot-inv-2d")
    loss, _ = losses(scene)
    weights = jnp.asarray(scene.weights())
    by = jax.grad(lambda w: loss({"weights": w}, *scene.initial_state()))(weights)
    run = whirls.rollout(scene, steps=4, every=2)
    expected = run.vjp(np.r_[np.zeros((1, *run.r.shape[1:])), np.cos(run.r[1:])] / run.r.size, 2 * run.v / run.v.size)
    np.testing.assert_allclose(by, expected[0]["weights"], rtol=1e-9)


def test_two_gradients_in_flight_share_nothing(scene):
    loss, _ = losses(scene)
    start = scene.initial_state()
    first, one = jax.vjp(lambda c: loss({"c": c}, *start), 8.0)
    second, two = jax.vjp(lambda c: loss({"c": c}, *start), 11.0)
    slope = jax.grad(lambda c: loss({"c": c}, *start))
    assert two(1.0)[0] == slope(11.0) and one(1.0)[0] == slope(8.0) and first != second


def test_what_cannot_run_is_refused_with_the_words_of_whirls(scene):
    loss, _ = losses(scene)
    start = scene.initial_state()
    with pytest.raises(Exception, match="expected one of c, alpha, beta"):
        jax.jit(loss)({"viscosity": 1.0}, *start).block_until_ready()
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(whirls.InputError, match="jax_enable_x64"):
        loss(POINT, *start)
