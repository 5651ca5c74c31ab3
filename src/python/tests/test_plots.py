"""What figures show."""

import numpy as np
import pytest

import whirls

pytest.importorskip("scipy")
matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")


def lattice(side, velocity):
    """Frames of one state on a square lattice in the box of length 2π."""
    each = (np.arange(side) + 0.5) * 2 * np.pi / side
    r = np.stack(np.meshgrid(each, each, indexing="ij"), axis=-1).reshape(-1, 2)
    v = velocity(r)
    still = np.zeros_like(v)
    return whirls.Frames(np.array([0.0, 1.0]), np.array([0, 1]), np.stack([r, r]), np.stack([still, v]),
                         np.ones((2, len(r))), np.array([2 * np.pi, 2 * np.pi]))


def taylor_green(r):
    x, y = r.T
    return np.stack([np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)], axis=-1)


def test_vorticity_of_a_taylor_green_vortex_is_that_of_the_formula_to_three_percent():
    from whirls import _plots

    found, speed = _plots.vorticity(lattice(64, taylor_green), 1, None, 48, 2 * np.pi / 64)
    x = (np.arange(48) + 0.5) * 2 * np.pi / 48
    expected = 2 * np.outer(np.sin(x), np.sin(x))
    assert np.abs(found - expected).max() < 0.03 * 2
    assert 0.95 < speed.max() < 1.0


def test_a_spectrum_has_the_energy_of_the_flow_in_its_shell():
    k, energy = lattice(64, taylor_green).spectrum(1)
    total = np.sum(energy) * (k[1] - k[0])
    # ½⟨v²⟩ is a quarter, all of it at k = √2, which is in the first shell.
    assert abs(total - 0.25) < 0.02 * 0.25
    assert energy[0] > 0.999 * energy.sum()


def test_figures_of_a_recording_have_their_curves(tmp_path):
    scene = whirls.Scene("inverse-2d", {"fluid.particles_per_side": 12, "learn.iterations": 3})
    path = tmp_path / "flow.mcap"
    whirls.simulate(scene, 6, record=path)
    recording = whirls.open(path)
    assert len(recording.plot_spectra().lines) == 1
    assert len(recording.plot_vorticity().images) == 1
    assert len(recording.plot_increments().patches) == 1
    found = whirls.learn(scene)
    named = {line.get_label() for line in found.plot_parameters().lines}
    assert {"c", "alpha", "beta", "gamma"} <= named
    assert len(found.plot().lines) == 1


def test_increments_of_the_first_frame_and_fields_without_a_box_are_refused():
    frames = lattice(8, taylor_green)
    with pytest.raises(whirls.InputError, match="later one"):
        frames.plot_increments(0)
    unknown = whirls.Frames(frames.t, frames.step, frames.r, frames.v, frames.rho, np.full(2, np.nan))
    with pytest.raises(whirls.InputError, match="known sides"):
        unknown.spectrum(1)
