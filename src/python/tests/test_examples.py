"""The examples do what they say."""

import importlib.util
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def load(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_sound_speed_and_initial_velocities_are_found_to_the_noise_of_what_is_seen():
    pytest.importorskip("scipy")
    noise = 1e-3
    found = load("inverse_problem").solve(side=6, steps=6, noise=noise)
    assert abs(found["c"] - found["true_c"]) < 1e-3 * found["true_c"]
    assert found["velocities_after"] < 3 * noise < 0.03 * found["velocities_before"]
    # As many unknowns are fitted as a fifth of what is seen: the misfit is that of the noise, and less by a fifth.
    assert 0.5 < found["loss_after"] < 1.0 < found["loss_before"]
