"""Rollouts as functions of PyTorch.

>>> import torch, whirls, whirls.torch
>>> scene = whirls.Scene("inverse-2d", {"fluid.particles_per_side": 8})
>>> run = whirls.torch.rollout(scene, steps=4)
>>> r0, v0 = map(torch.from_numpy, scene.initial_state())
>>> c = torch.tensor(8.0, dtype=torch.float64, requires_grad=True)
>>> r, v = run({"c": c}, r0, v0)                            # (frames, N, d)
>>> (v[-1] ** 2).mean().backward()
>>> bool(c.grad.abs() > 0)
True

The operators ``whirls::rollout`` and ``whirls::rollout_vjp`` have shapes that ``torch.compile`` knows. The engine runs on
the processor in double precision. Nothing is kept between the way forth and the way back: a gradient costs the run, and
the run repeated with its adjoint. There are no second derivatives.
"""

from __future__ import annotations

import json
import os
from functools import lru_cache
from typing import Any, Callable, Mapping

import torch
from torch import Tensor

from . import rollout as _rollout
from ._errors import refuse
from ._parameters import WEIGHTS
from ._rollout import as_storage
from ._scene import Scene, as_scene

Run = Callable[[Mapping[str, Any], Any, Any], tuple[Tensor, Tensor]]

_scene = lru_cache(maxsize=8)(Scene)


def _run(plan: str, parameters: Tensor, r0: Tensor, v0: Tensor, back: bool) -> Any:
    known = json.loads(plan)
    values = dict(zip(known["names"], parameters.detach().tolist()))
    storage = known["storage"] if back else {"checkpoints": 1}
    return _rollout(_scene(known["scene"]), known["steps"], every=known["every"], parameters=values,
                    positions=r0.detach().numpy(), velocities=v0.detach().numpy(), storage=storage)


@torch.library.custom_op("whirls::rollout", mutates_args=())
def _forward(plan: str, parameters: Tensor, r0: Tensor, v0: Tensor) -> tuple[Tensor, Tensor]:
    found = _run(plan, parameters, r0, v0, False)
    return torch.from_numpy(found.r), torch.from_numpy(found.v)


@_forward.register_fake
def _(plan: str, parameters: Tensor, r0: Tensor, v0: Tensor) -> tuple[Tensor, Tensor]:
    known = json.loads(plan)
    frames = known["steps"] // known["every"] + 1
    return r0.new_empty((frames, *r0.shape)), r0.new_empty((frames, *r0.shape))


@torch.library.custom_op("whirls::rollout_vjp", mutates_args=())
def _backward(
    plan: str, parameters: Tensor, r0: Tensor, v0: Tensor, r: Tensor, v: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    found = _run(plan, parameters, r0, v0, True)
    by, by_r0, by_v0 = found.vjp(r.detach().numpy(), v.detach().numpy())
    weights = by.get(WEIGHTS, ())
    names = json.loads(plan)["names"]
    flat = [by[name] if name in by else weights[int(name[1:])] for name in names]
    return torch.tensor(flat, dtype=torch.float64), torch.from_numpy(by_r0), torch.from_numpy(by_v0)


@_backward.register_fake
def _(
    plan: str, parameters: Tensor, r0: Tensor, v0: Tensor, r: Tensor, v: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    return torch.empty_like(parameters), torch.empty_like(r0), torch.empty_like(v0)


def _keep(ctx: Any, inputs: Any, output: Any) -> None:
    ctx.plan = inputs[0]
    ctx.save_for_backward(*inputs[1:])


def _back(ctx: Any, r: Tensor | None, v: Tensor | None) -> Any:
    parameters, r0, v0 = ctx.saved_tensors
    known = json.loads(ctx.plan)
    zero = lambda: r0.new_zeros((known["steps"] // known["every"] + 1, *r0.shape))  # noqa: E731
    r, v = zero() if r is None else r.contiguous(), zero() if v is None else v.contiguous()
    return (None, *_backward(ctx.plan, parameters, r0, v0, r, v))


_forward.register_autograd(_back, setup_context=_keep)


def rollout(
    scene: Scene | str | os.PathLike[str] | Mapping[str, Any], steps: int, *, every: int = 1, storage: Any = None
) -> Run:
    """A function ``run(parameters, r0, v0) -> (r, v)`` with the adjoint of the engine as its derivative.

    ``parameters`` is a dict of numbers or tensors by name and perhaps ``"weights" (W,)``; ``r0``, ``v0`` are ``(N, d)``;
    the results are positions inside the periodic box and velocities, ``(steps / every + 1, N, d)``, of which the first
    frame is the start. Use :meth:`whirls.Scene.nearest_image` for differences of positions. ``storage`` is as in
    :func:`whirls.rollout`.

    Raises :class:`whirls.InputError` and :class:`whirls.DivergedError`.
    """
    scene = as_scene(scene)
    if every < 1 or steps % every:
        raise refuse("the frames of a rollout", "a number of steps that is a multiple of every",
                     f"steps={steps}, every={every}", "let the run end with a frame")
    kind, number = as_storage(scene, storage)
    plan = {
        "scene": scene.to_toml(),
        "steps": steps,
        "every": every,
        "storage": kind if kind == "all" else {kind: number},
    }

    def run(parameters: Mapping[str, Any], r0: Any, v0: Any) -> tuple[Tensor, Tensor]:
        names: list[str] = []
        parts: list[Tensor] = []
        for name, value in parameters.items():
            part = torch.as_tensor(value, dtype=torch.float64).reshape(-1)
            parts.append(part)
            names += [f"w{k}" for k in range(len(part))] if name == WEIGHTS else [name]
            if name != WEIGHTS and len(part) != 1:
                raise refuse(f"parameters[{name!r}]", "a number", f"{len(part)} numbers", "give a real number")
        flat = torch.cat(parts) if parts else torch.empty(0, dtype=torch.float64)
        r0, v0 = (torch.as_tensor(x, dtype=torch.float64).contiguous() for x in (r0, v0))
        return _forward(json.dumps({**plan, "names": names}), flat, r0, v0)

    return run
