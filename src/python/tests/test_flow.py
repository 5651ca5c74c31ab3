"""Flows: the same bits however they are run, arrays of every kind, progress, interruption."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest

import whirls
from conftest import small


def test_steps_one_by_one_and_all_at_once_give_the_same_bits(scene):
    frames = whirls.simulate(scene, 6, 3)
    flow = whirls.Flow(scene)
    for _ in range(6):
        flow.step()
    assert frames.r.shape == (3, scene.particles, scene.dimension) and list(frames.step) == [0, 3, 6]
    assert np.array_equal(frames.r[-1], flow.positions) and np.array_equal(frames.v[-1], flow.velocities)
    assert np.array_equal(frames.rho[-1], flow.densities)
    assert flow.time == frames.t[-1] == pytest.approx(6 * scene.dt)
    assert ((frames.r >= 0) & (frames.r < scene.sides)).all()


def test_a_flow_starts_where_arrays_of_any_kind_say(scene):
    class OnlyDlpack:
        def __init__(self, array):
            self.array = array

        def __dlpack__(self, **how):
            return self.array.__dlpack__(**how)

        def __dlpack_device__(self):
            return self.array.__dlpack_device__()

    r, v = scene.initial_state()
    own = whirls.simulate(scene, 2).v[-1]
    kinds = [(r, v), (np.asfortranarray(r), v.tolist()), (OnlyDlpack(r), OnlyDlpack(v))]
    for positions, velocities in kinds:
        found = whirls.simulate(scene, 2, positions=positions, velocities=velocities)
        assert np.array_equal(found.v[-1], own)


def test_momentum_is_kept_to_round_off_and_statistics_agree(scene):
    flow = whirls.Flow(scene)
    flow.step(3)
    rates, scale = flow.momentum_rates()
    assert max(np.abs(rate).max() for rate in rates.values()) < 1e-13 * scale
    found = flow.statistics()
    assert found["momentum"] == pytest.approx(flow.mass * flow.velocities.sum(axis=0))
    assert found["kinetic_energy"] == pytest.approx(0.5 * flow.mass * (flow.velocities**2).sum())
    assert flow.spectrum(16).sum() > 0 and flow.accelerations.shape == flow.velocities.shape


def test_the_model_of_a_scene_and_its_truth_are_other_laws():
    scene = small("rot-inv-2d")
    truth, model = (whirls.simulate(scene, 2, law=law).v[-1] for law in ("truth", "model"))
    other = whirls.simulate(scene, 2, law="model", parameters={"weights": scene.weights(5)}).v[-1]
    assert not np.array_equal(truth, model) and not np.array_equal(model, other)


def test_a_flow_that_diverges_says_where_and_keeps_its_frames():
    scene = small("inverse-2d", forcing={"kind": "deterministic", "theta": 3000.0})
    with pytest.raises(whirls.DivergedError) as caught:
        whirls.simulate(scene, 50)
    error = caught.value
    assert error.step >= 0 and error.quantity and error.remedy and "diverged at step" in str(error)
    assert len(error.frames) == error.step + 1 and np.isfinite(error.frames.v[:-1]).all()


def test_a_wrong_shape_is_named():
    scene = small("inverse-2d")
    r, v = scene.initial_state()
    with pytest.raises(whirls.InputError, match=r"shape \(64, 2\), found shape \(63, 2\)"):
        whirls.Flow(scene, r, v[1:])
    with pytest.raises(whirls.InputError, match="complex128"):
        whirls.Flow(scene, r * 1j, v)
    with pytest.raises(whirls.InputError, match="positions without velocities"):
        whirls.Flow(scene, r)


def test_a_bar_gets_every_step_once():
    class Bar:
        total, done, closed = None, 0, False

        def update(self, n):
            self.done += n

        def close(self):
            self.closed = True

    bar = Bar()
    whirls.Flow(small("inverse-2d")).step(7, progress=bar)
    assert bar.done == 7 and not bar.closed

    made = []
    whirls.simulate(small("inverse-2d"), 3, progress=lambda total, desc: made.append(Bar()) or made[0])
    assert made[0].done == 3 and made[0].closed
    with pytest.raises(whirls.InputError, match="update"):
        whirls.simulate(small("inverse-2d"), 3, progress=3)


def test_an_interrupt_from_another_thread_stops_a_run_within_a_step_and_the_flow_goes_on():
    """The thread that sends the signal runs only while the interpreter is released."""
    child = textwrap.dedent(
        """
        import os, signal, threading, whirls
        # A shell may have started all of this with the signal ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        flow = whirls.Flow(whirls.Scene("inverse-2d", {"fluid.particles_per_side": 24}))
        threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
        try:
            flow.step(10**9)
        except KeyboardInterrupt:
            there = flow.steps
            flow.step(2)
            print("stopped", flow.steps - there)
        """
    )
    found = subprocess.run([sys.executable, "-c", child], capture_output=True, text=True, timeout=120)
    assert found.stdout.split() == ["stopped", "2"], found.stderr
