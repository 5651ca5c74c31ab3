# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---
# %% [markdown]
# # A network of one's own, trained through the flow
#
# The initial velocities of a flow are unknown. A small network of JAX maps a place to a velocity, `v₀ = f(r₀)`, and is
# trained so that the flow which starts there has the noisy velocities that are seen later: its gradient goes through
# every step of SPH. Run it as a script, `python network_through_rollout.py --side 16`, or open it as a notebook (jupytext).

# %%
from __future__ import annotations

import argparse

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.optimize import minimize

import whirls
import whirls.jax

jax.config.update("jax_enable_x64", True)

# %% [markdown]
# The network: one hidden layer over the first waves of the periodic box, so that it is periodic, too.


# %%
def waves(r):
    """`(N, d)` places as `(N, 4d)` numbers that are the same on both sides of the box of length 2π."""
    return jnp.concatenate([f(k * r) for k in (1, 2) for f in (jnp.sin, jnp.cos)], axis=1)


def network(weights, r):
    """Velocities `(N, d)` at places `(N, d)`."""
    hidden = jnp.tanh(waves(r) @ weights["in"] + weights["shift"])
    return hidden @ weights["out"]


def first_weights(dimension, hidden, seed=0):
    """Random weights of a network that starts nearly at rest."""
    random = np.random.default_rng(seed)
    scale = 1 / np.sqrt(4 * dimension)
    return {
        "in": scale * random.standard_normal((4 * dimension, hidden)),
        "shift": np.zeros(hidden),
        "out": 0.01 * random.standard_normal((hidden, dimension)),
    }


# %% [markdown]
# The truth starts as a Taylor–Green vortex. The loss compares velocities of later frames; one call of `jax.grad` runs
# the flow there and back.


# %%
def solve(side, steps=10, hidden=24, noise=0.01, iterations=150):
    """Returns the root-mean-square error of the initial velocities before and after, and the misfit in units of the noise."""
    scene = whirls.Scene("inverse-2d", {"fluid.particles_per_side": side, "forcing": {"kind": "none"}})
    r0, _ = scene.initial_state()
    x, y = r0.T
    v0 = np.stack([np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)], axis=1)
    truth = whirls.rollout(scene, steps, positions=r0, velocities=v0)
    seen = truth.v[1:] + noise * np.random.default_rng(1).standard_normal(truth.v[1:].shape)
    run = whirls.jax.rollout(scene, steps)
    flat, unflatten = ravel_pytree(first_weights(2, hidden))

    @jax.jit
    def loss(flat):
        _, v = run({}, r0, network(unflatten(flat), r0))
        return jnp.mean(((v[1:] - seen) / noise) ** 2)

    slope = jax.jit(jax.value_and_grad(loss))

    def both(flat):
        value, gradient = slope(flat)
        return float(value), np.asarray(gradient)

    found = minimize(both, np.asarray(flat), jac=True, method="L-BFGS-B", options={"maxiter": iterations})
    error = lambda flat: float(np.sqrt(np.mean((np.asarray(network(unflatten(flat), r0)) - v0) ** 2)))  # noqa: E731
    return {
        "before": error(flat),
        "after": error(found.x),
        "misfit": float(found.fun),
        "weights": flat.size,
        "iterations": found.nit,
    }


# %%
def main():
    parser = argparse.ArgumentParser(description="A network for the initial velocities of a flow, trained through it.")
    parser.add_argument("--side", type=int, default=16, help="particles along each axis")
    given, _ = parser.parse_known_args()
    found = solve(given.side)
    print(f"{found['weights']} weights, {found['iterations']} iterations")
    print(f"initial velocities: error {found['before']:.3f} before, {found['after']:.4f} after")
    print(f"misfit over noise, squared: {found['misfit']:.3f}")


if __name__ == "__main__":
    main()
