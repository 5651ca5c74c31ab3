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


def test_a_network_for_the_initial_velocities_is_trained_through_the_flow_to_a_tenth_of_its_error():
    pytest.importorskip("jax")
    pytest.importorskip("scipy")
    found = load("network_through_rollout").solve(side=8, steps=6)
    assert found["after"] < 0.1 * found["before"]


def test_a_table_of_noisy_tracks_becomes_a_law_within_three_standard_errors(tmp_path):
    found = load("tracks_to_law").solve(tmp_path / "tracks.csv", side=12, frames=8)
    law = found["estimated first frame"]
    for name, truth in (("c", 12.0), ("alpha", 1.0)):
        assert abs(law.parameters[name] - truth) < 3 * law.standard_errors[name]
    assert law.knowledge["first_frames"]["chi_squared"] == pytest.approx(1.0, abs=0.1)
    assert found["exact first frame"].first_frame is None
    assert [array.shape for array in law.first_frame] == [(144, 2), (144, 2)]
