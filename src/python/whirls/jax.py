"""Rollouts as functions of JAX.

>>> import jax, jax.numpy as jnp, whirls, whirls.jax
>>> jax.config.update("jax_enable_x64", True)
>>> scene = whirls.Scene("inverse-2d", {"fluid.particles_per_side": 8})
>>> run = whirls.jax.rollout(scene, steps=4)
>>> r0, v0 = scene.initial_state()
>>> def loss(parameters, r0, v0):
...     r, v = run(parameters, r0, v0)                      # (frames, N, d)
...     return jnp.mean(v[-1] ** 2)
>>> by, by_r0 = jax.grad(loss, argnums=(0, 1))({"c": 8.0, "alpha": 0.5}, r0, v0)
>>> by_r0.shape
(64, 2)

JAX allows one rule a function, so that there are two: :func:`rollout` for reverse mode (``grad``, ``vjp``, ``jacrev``),
:func:`rollout_jvp` for forward mode (``jvp``, ``jacfwd``). Both run under ``jit``; ``vmap`` runs one after another, but all
tangents of one point together, so that ``jacfwd`` is one run.
The engine runs on the processor in double precision, so that ``jax_enable_x64`` is needed. Nothing is kept between the
way forth and the way back: a gradient costs the run, and the run repeated with its adjoint. Errors inside ``jit`` arrive
as errors of JAX with the words of whirls; and Ctrl-C waits for the call to end, since JAX runs it on a thread of its own.
"""

from __future__ import annotations

import os
from typing import Any, Callable, Mapping

import numpy as np

import jax
import jax.numpy as jnp

from . import rollout as _rollout
from ._errors import refuse
from ._rollout import as_storage
from ._scene import Scene, as_scene

Parameters = Mapping[str, Any]
Run = Callable[[Parameters, Any, Any], tuple[jax.Array, jax.Array]]

# Without a way back nothing is kept of a run.
_FORWARD = {"checkpoints": 1}


class _Plan:
    """What does not depend on the arguments."""

    def __init__(self, scene: Any, steps: int, every: int, storage: Any) -> None:
        self.scene: Scene = as_scene(scene)
        if every < 1 or steps % every:
            raise refuse("the frames of a rollout", "a number of steps that is a multiple of every",
                         f"steps={steps}, every={every}", "let the run end with a frame")
        self.steps, self.every = steps, every
        kind, number = as_storage(self.scene, storage)
        self.storage = kind if kind == "all" else {kind: number}

    def run(self, parameters: Parameters, r0: Any, v0: Any, storage: Any) -> Any:
        values = {name: np.asarray(value) for name, value in parameters.items()}
        return _rollout(self.scene, self.steps, every=self.every, parameters=values, positions=np.asarray(r0),
                        velocities=np.asarray(v0), storage=storage)

    def frames(self, r0: Any) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((self.steps // self.every + 1, *r0.shape), jnp.float64)

    def forward(self, parameters: Parameters, r0: Any, v0: Any) -> tuple[jax.Array, jax.Array]:
        def call(parameters: Any, r0: Any, v0: Any) -> Any:
            found = self.run(parameters, r0, v0, _FORWARD)
            return found.r, found.v

        shape = self.frames(r0)
        return jax.pure_callback(call, (shape, shape), parameters, r0, v0, vmap_method="sequential")


def _doubles(parameters: Parameters, r0: Any, v0: Any) -> tuple[dict[str, jax.Array], jax.Array, jax.Array]:
    if jnp.result_type(float) != jnp.float64:
        raise refuse("whirls.jax", "double precision", "jax_enable_x64 = False",
                     'call jax.config.update("jax_enable_x64", True) at the start')
    double = lambda x: jnp.asarray(x, jnp.float64)  # noqa: E731
    r0, v0 = double(r0), double(v0)
    if r0.ndim != 2 or r0.shape != v0.shape:
        raise refuse("the start of a rollout", "positions and velocities of one shape (N, d)",
                     f"shapes {r0.shape} and {v0.shape}", "bring their axes into that order")
    return {name: double(value) for name, value in parameters.items()}, r0, v0


def rollout(
    scene: Scene | str | os.PathLike[str] | Mapping[str, Any], steps: int, *, every: int = 1, storage: Any = None
) -> Run:
    """A function ``run(parameters, r0, v0) -> (r, v)`` with the adjoint of the engine as its derivative.

    ``parameters`` is a dict of scalars by name and perhaps ``"weights" (W,)``; ``r0``, ``v0`` are ``(N, d)``; the results
    are positions inside the periodic box and velocities, ``(steps / every + 1, N, d)``, of which the first frame is the
    start. Use :meth:`whirls.Scene.nearest_image` for differences of positions. ``storage`` is as in
    :func:`whirls.rollout`.
    """
    plan = _Plan(scene, steps, every, storage)

    @jax.custom_vjp
    def run(parameters: Any, r0: Any, v0: Any) -> Any:
        return plan.forward(parameters, r0, v0)

    def there(parameters: Any, r0: Any, v0: Any) -> Any:
        return plan.forward(parameters, r0, v0), (parameters, r0, v0)

    def back(kept: Any, cotangents: Any) -> Any:
        def call(parameters: Any, r0: Any, v0: Any, r: Any, v: Any) -> Any:
            found = plan.run(parameters, r0, v0, plan.storage)
            by, by_r0, by_v0 = found.vjp(np.asarray(r), np.asarray(v))
            return {name: np.asarray(by[name]) for name in parameters}, by_r0, by_v0

        shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), kept)
        return jax.pure_callback(call, shapes, *kept, *cotangents, vmap_method="sequential")

    run.defvjp(there, back)
    return lambda parameters, r0, v0: run(*_doubles(parameters, r0, v0))


def _along(plan: _Plan, batched: Any, ranks: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives along tangents with leading axes of a batch: one run for all tangents of one point."""
    leaves, tree = jax.tree.flatten(batched)
    leaves = [np.asarray(x) for x in leaves]
    leads = [x.shape[: x.ndim - rank] for x, rank in zip(leaves, ranks)]
    lead = np.broadcast_shapes(*leads)
    size = int(np.prod(lead, dtype=int))
    # Half of the leaves are the point, half its tangents.
    is_one_point = all(np.prod(own, dtype=int) == 1 for own in leads[: len(leads) // 2])
    rows = []
    for x, own in zip(leaves, leads):
        core = x.shape[len(own):]
        full = x.reshape((1,) * (len(lead) - len(own)) + x.shape)
        rows.append(np.broadcast_to(full, (*lead, *core)).reshape(size, *core))
    points = [jax.tree.unflatten(tree, [row[k] for row in rows]) for k in range(size)]
    found = []
    for group in [points] if is_one_point else [[point] for point in points]:
        parameters, r0, v0 = group[0][:3]
        run = plan.run(parameters, r0, v0, _FORWARD)
        found += run.jvps([point[3:] for point in group])
    frames = (plan.steps // plan.every + 1, *leaves[-1].shape[-2:])
    stack = [np.reshape([each[k] for each in found], (*lead, *frames)) for k in (0, 1)]
    return stack[0], stack[1]


def rollout_jvp(
    scene: Scene | str | os.PathLike[str] | Mapping[str, Any], steps: int, *, every: int = 1
) -> Run:
    """As :func:`rollout`, with the forward sensitivities of the engine as its derivative."""
    plan = _Plan(scene, steps, every, _FORWARD)

    @jax.custom_jvp
    def run(parameters: Any, r0: Any, v0: Any) -> Any:
        return plan.forward(parameters, r0, v0)

    @run.defjvp
    def along(primals: Any, tangents: Any) -> Any:
        ranks = [len(x.shape) for x in jax.tree.leaves((primals, tangents))]
        shape = plan.frames(primals[1])

        def call(*batched: Any) -> Any:
            return _along(plan, batched, ranks)

        # Mapped arguments come with a leading axis, the others with one of length 1.
        changed = jax.pure_callback(call, (shape, shape), *primals, *tangents, vmap_method="expand_dims")
        return plan.forward(*primals), changed

    return lambda parameters, r0, v0: run(*_doubles(parameters, r0, v0))
