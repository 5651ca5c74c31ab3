"""The built-in search from Python, and recordings."""

import numpy as np
import pytest

import whirls
from conftest import small

GUESS = {"c": 8.0, "alpha": 0.6, "beta": 1.0, "gamma": 5.0}


def test_parameters_are_found_from_the_scene_from_arrays_and_from_a_recording(tmp_path):
    scene = small("inverse-2d", learn__windows=[], learn__frames=6, learn__after=0, record__every=1)
    path = tmp_path / "truth.mcap"
    frames = whirls.simulate(scene, 6, record=path)
    truths = [None, frames, {"r": frames.r, "v": frames.v}, path, whirls.open(path)]
    for truth in truths:
        found = whirls.learn(scene, truth, guess=GUESS)
        for name, value in scene.parameters.items():
            if name in found.parameters:
                assert found.parameters[name] == pytest.approx(value, rel=1e-6), name
        assert found.converged and found.loss < 1e-15 < found.initial_loss
        history = found.history
        assert history["loss"][0] == found.initial_loss and history["c"][0] == GUESS["c"]
        assert len({len(column) for column in history.values()}) == 1
        assert set(found.standard_errors) <= set(found.parameters) and found.lines


def test_standard_errors_cover_the_truth_where_the_data_carry_noise():
    scene = small("inverse-2d", learn__windows=[], learn__frames=6, learn__after=0)
    frames = whirls.simulate(scene, 6)
    rng = np.random.default_rng(3)
    noise = 1e-4 * rng.standard_normal(frames.v.shape)
    noise[0] = 0.0
    found = whirls.learn(scene, {"r": frames.r, "v": frames.v + noise}, guess=GUESS)
    errors = found.standard_errors
    assert errors["c"] > 1e-8 and abs(found.parameters["c"] - scene.parameters["c"]) < 4 * errors["c"]


def test_weights_are_learned_as_one_array():
    scene = small("rot-inv-2d", learn__windows=[], learn__iterations=3, learn__frames=3, learn__after=2)
    found = whirls.learn(scene)
    assert found.parameters["weights"].shape == scene.weights().shape
    assert found.history["weights"].shape == (len(found.history["loss"]), len(scene.weights()))
    assert found.loss < found.initial_loss


def test_what_does_not_fit_the_scene_is_refused():
    scene = small("inverse-2d")
    frames = whirls.simulate(scene, 3)
    with pytest.raises(whirls.InputError, match="at least 16 frames"):
        whirls.learn(scene, frames)
    with pytest.raises(whirls.InputError, match="the guess"):
        whirls.learn(small("inverse-2d", learn__after=0), guess={"viscosity": 1.0})
    with pytest.raises(whirls.InputError, match="the truth"):
        whirls.learn(scene, 3)


def test_a_recording_is_read_back_bit_for_bit(tmp_path, scene):
    path = tmp_path / "flow.mcap"
    frames = whirls.simulate(scene, 4, 2, record=path)
    recording = whirls.open(path)
    for name in ("t", "r", "v", "rho"):
        assert np.array_equal(getattr(recording, name), getattr(frames, name)), name
    some = recording.frames("truth", slice(1, None))
    assert np.array_equal(some.r, frames.r[1:]) and list(some.step) == [2, 4]
    assert recording.scene.to_toml().split() and not recording.is_truncated
    assert len(recording.learned) == 0 and recording.iterations["loss"].size == 0
    path.write_bytes(b"mine")
    with pytest.raises(whirls.InputError, match="whirls did not record"):
        whirls.simulate(scene, 1, record=path)


def test_frames_become_a_dataset_with_named_axes(scene):
    pytest.importorskip("xarray")
    frames = whirls.simulate(scene, 2)
    data = frames.to_xarray()
    assert data.position.dims == ("time", "particle", "axis") and data.sizes["particle"] == scene.particles
    assert list(data.axis.values) == list("xyz")[: scene.dimension]


def test_frames_and_searches_are_drawn(scene):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    axes = whirls.simulate(scene, 1).plot()
    assert axes.collections and axes.get_title().startswith("t = ")


def test_frames_and_recordings_are_written_for_the_viewer(tmp_path, scene):
    pytest.importorskip("rerun")
    frames = whirls.simulate(scene, 2, record=tmp_path / "flow.mcap")
    for what in (frames, tmp_path / "flow.mcap", whirls.open(tmp_path / "flow.mcap")):
        saved = tmp_path / "flow.rrd"
        whirls.show(what, save=saved)
        assert saved.stat().st_size > frames.r.nbytes / 10
        saved.unlink()
    with pytest.raises(whirls.InputError, match="a recording"):
        whirls.show(3, save=tmp_path / "flow.rrd")
