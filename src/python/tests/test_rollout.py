"""Derivatives of rollouts."""

import gc

import numpy as np
import pytest

import whirls
from conftest import small

STEPS = {"steps": 4, "every": 2}


def point(scene, seed=0):
    """A start off the lattice, cotangents of every frame, and a direction."""
    rng = np.random.default_rng(seed)
    r, v = scene.initial_state()
    r = r + 0.05 * scene.mass ** (1 / scene.dimension) * rng.standard_normal(r.shape)
    cotangents = [rng.standard_normal((3, *shape)) for shape in (r.shape, r.shape, r.shape[:1])]
    direction = 0.1 * rng.standard_normal(r.shape), rng.standard_normal(r.shape)
    return (r, v), cotangents, direction


def loss(run, base, cotangents):
    r, v, rho = cotangents
    moved = run.scene.nearest_image(run.r - base.r)
    return (r * moved).sum() + (v * (run.v - base.v)).sum() + (rho * (run.rho - base.rho)).sum()


def test_vjp_equals_central_differences_by_every_parameter_and_the_start(scene):
    (r0, v0), cotangents, (dr, dv) = point(scene)
    values = {name: value for name, value in scene.parameters.items() if value}

    def run(by, r, v):
        return whirls.rollout(scene, **STEPS, parameters=by, positions=r, velocities=v)

    base = run(values, r0, v0)
    by, by_r, by_v = base.vjp(*cotangents)

    def central(along, size=3e-6):
        ends = [loss(along(k * size), base, cotangents) for k in (-2, -1, 1, 2)]
        return (8 * (ends[2] - ends[1]) - (ends[3] - ends[0])) / (12 * size)

    for name, value in values.items():
        found = central(lambda e: run({**values, name: value * (1 + e)}, r0, v0))
        assert found == pytest.approx(value * by[name], rel=1e-6), name
    assert central(lambda e: run(values, r0 + e * dr, v0)) == pytest.approx((by_r * dr).sum(), rel=1e-6)
    assert central(lambda e: run(values, r0, v0 + e * dv)) == pytest.approx((by_v * dv).sum(), rel=1e-6)


@pytest.mark.parametrize("name", ["inverse-2d", "inverse-3d", "rot-inv-2d"])
def test_jvp_is_the_transpose_of_vjp_to_round_off(name):
    scene = small(name)
    (r0, v0), cotangents, (dr, dv) = point(scene)
    run = whirls.rollout(scene, **STEPS, positions=r0, velocities=v0)
    by, by_r, by_v = run.vjp(*cotangents)
    rng = np.random.default_rng(1)
    change = {key: 0.1 * rng.standard_normal(np.shape(value)) for key, value in run.parameters.items()}
    tangents = run.jvp(change, dr, dv)
    forwards = sum((a * b).sum() for a, b in zip(cotangents, tangents))
    size = sum(np.abs(a * b).sum() for a, b in zip(cotangents, tangents))
    backwards = sum(np.dot(by[key], change[key]) for key in by) + (by_r * dr).sum() + (by_v * dv).sum()
    assert abs(forwards - backwards) < 1e-12 * size
    assert abs(forwards) > 1e-6 * size
    assert ("weights" in by) == (name == "rot-inv-2d")


def test_every_storage_gives_the_same_bits_and_a_second_call_too(scene):
    (r0, v0), cotangents, _ = point(scene)

    def found(storage):
        run = whirls.rollout(scene, **STEPS, positions=r0, velocities=v0, storage=storage)
        return [run.vjp(*cotangents) for _ in range(2)]

    (by, by_r, by_v), _ = found("all")
    for storage in ("all", {"checkpoints": 1}, {"bytes": 50_000_000}, "50 MB"):
        for other, other_r, other_v in found(storage):
            assert other == by and np.array_equal(other_r, by_r) and np.array_equal(other_v, by_v)


def test_two_rollouts_that_overlap_share_nothing(scene):
    (r0, v0), cotangents, _ = point(scene)
    start = {"positions": r0, "velocities": v0}
    first = whirls.rollout(scene, **STEPS, **start, parameters={"c": 9.0})
    expected = first.vjp(*cotangents)[0]
    first = whirls.rollout(scene, **STEPS, **start, parameters={"c": 9.0})
    second = whirls.rollout(scene, **STEPS, **start, parameters={"c": 11.0})
    other = second.vjp(*cotangents)[0]
    del second
    gc.collect()
    assert first.vjp(*cotangents)[0] == expected and other != expected


def test_what_a_rollout_cannot_mean_is_refused(scene):
    run = whirls.rollout(scene, **STEPS)
    with pytest.raises(whirls.InputError, match="the cotangent of v"):
        run.vjp(v=run.v[1:])
    with pytest.raises(whirls.InputError, match="finite"):
        run.vjp(v=np.full_like(run.v, np.nan))
    with pytest.raises(whirls.InputError, match="multiple"):
        whirls.rollout(scene, steps=5, every=2)
    with pytest.raises(whirls.InputError, match="alpha"):
        whirls.rollout(scene, steps=1, parameters={"viscosity": 1.0})
    with pytest.raises(whirls.InputError, match="500 MB"):
        whirls.rollout(scene, steps=1, storage="much")
    with pytest.raises(whirls.InputError, match="at least"):
        whirls.rollout(scene, steps=1, storage={"bytes": 10})
