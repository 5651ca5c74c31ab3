"""An inverse problem with a loss of one's own: speed of sound and all initial velocities of a flow, from noisy velocities
of its later frames.

    python src/python/examples/inverse_problem.py --side 16

The unknowns are ``c`` and the ``(N, d)`` initial velocities, 513 numbers together at the default size. Each
gradient is one rollout and one call of ``vjp``; the search is limited-memory BFGS of scipy.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.optimize import minimize

import whirls


def solve(side: int, steps: int = 8, noise: float = 1e-3, iterations: int = 200) -> dict[str, float]:
    """Solves the problem and returns errors: of ``c``, and of the initial velocities (root mean square) before and after,
    and the loss at both ends, in units of the noise's variance."""
    scene = whirls.Scene("inverse-2d", {"fluid.particles_per_side": side, "forcing": {"kind": "none"}})
    truth = whirls.simulate(scene, steps)
    generator = np.random.default_rng(1)
    seen = truth.v + noise * generator.standard_normal(truth.v.shape)
    r0, shape = truth.r[0], truth.v[0].shape
    true_c = scene.parameters["c"]

    def loss(unknown: np.ndarray) -> tuple[float, np.ndarray]:
        c, v0 = np.exp(unknown[0]), unknown[1:].reshape(shape)
        run = whirls.rollout(scene, steps, parameters={"c": c}, positions=r0, velocities=v0)
        # The first frame is not seen.
        misfit = run.v - seen
        misfit[0] = 0.0
        scale = 1 / (noise**2 * misfit[1:].size)
        by, _, by_v0 = run.vjp(v=2 * scale * misfit)
        return scale * (misfit**2).sum(), np.concatenate([[c * by["c"]], by_v0.ravel()])

    # The guess: a sound speed that is a fifth too small, and the velocities of the first frame that is seen.
    guess = np.concatenate([[np.log(0.8 * true_c)], seen[1].ravel()])
    found = minimize(loss, guess, jac=True, method="L-BFGS-B",
                     options={"maxiter": iterations, "maxcor": 20, "ftol": 1e-12, "gtol": 1e-9})
    error = lambda unknown: float(np.sqrt(np.mean((unknown[1:].reshape(shape) - truth.v[0]) ** 2)))  # noqa: E731
    return {
        "c": float(np.exp(found.x[0])),
        "true_c": true_c,
        "velocities_before": error(guess),
        "velocities_after": error(found.x),
        "loss_before": loss(guess)[0],
        "loss_after": float(found.fun),
        "iterations": float(found.nit),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--side", type=int, default=16, help="particles along each axis")
    parser.add_argument("--steps", type=int, default=8)
    parser.add_argument("--noise", type=float, default=1e-3, help="standard deviation of the velocities that are seen")
    given = parser.parse_args()
    found = solve(given.side, given.steps, given.noise)
    print(f"c = {found['c']:.6f}, true {found['true_c']:.6f}")
    print(f"initial velocities: error {found['velocities_before']:.2e} of the guess, {found['velocities_after']:.2e} found")
    print(f"misfit over noise, squared: {found['loss_before']:.3g} -> {found['loss_after']:.3g} "
          f"in {found['iterations']:.0f} iterations")


if __name__ == "__main__":
    main()
