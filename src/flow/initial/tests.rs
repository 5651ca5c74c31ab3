//! Tests of every velocity field, and of each one separately.

use super::*;
use crate::flow::State;
use crate::losses::Mesh;
use crate::random::{Stream, stream};
use crate::statistics::energy_spectrum;
use rand::RngExt;
use rand_distr::StandardNormal;

/// An unperturbed lattice of `per_side` particles in a box of side 3.
fn scene<const D: usize>(per_side: usize, field: &str) -> Scene {
    let name = if D == 2 { "inverse-2d" } else { "inverse-3d" };
    let all = [
        format!("fluid.particles_per_side={per_side}"),
        "fluid.box_length=3.0".to_owned(),
        "initial.jitter=0.0".to_owned(),
        "initial.velocity=0.7".to_owned(),
        format!("initial.field={field}"),
    ];
    Scene::open(name, &all).unwrap()
}

/// The largest sum of `∂ᵢuᵢ` by central differences on the lattice, in units of `2π/L · u'`.
fn divergence<const D: usize>(per_side: usize, velocities: &[Vector<f64, D>]) -> f64 {
    let beside = |index: usize, axis: usize, by: usize| {
        let stride = per_side.pow(axis as u32);
        let along = index / stride % per_side;
        index - along * stride + (along + by) % per_side * stride
    };
    let at = |index: usize| {
        let along = |axis: usize| {
            let (next, before) = (beside(index, axis, 1), beside(index, axis, per_side - 1));
            velocities[next][axis] - velocities[before][axis]
        };
        (0..D).map(along).sum::<f64>() * per_side as f64 / (4.0 * std::f64::consts::PI)
    };
    (0..velocities.len()).map(|index| at(index).abs()).fold(0.0, f64::max) / 0.7
}

fn mean_square<const D: usize>(velocities: &[Vector<f64, D>]) -> f64 {
    velocities.iter().map(|v| v.norm_squared()).sum::<f64>() / velocities.len() as f64
}

const VON_KARMAN: &str =
    "{kind='random-solenoidal',spectrum={kind='von-karman',peak=2.5,largest=5}}";
const POWER_LAW: &str =
    "{kind='random-solenoidal',spectrum={kind='power-law',exponent=-1.6,smallest=2,largest=5}}";
const BAND: &str = "{kind='random-solenoidal',spectrum={kind='band',largest=3}}";

#[test]
fn a_scene_without_a_field_starts_with_the_bits_it_always_had() {
    let scene = Scene::shipped("inverse-2d").unwrap();
    let mut generator = stream(scene.seed, Stream::Initial);
    (0..2 * scene.particles()).for_each(|_| _ = generator.random::<f64>());
    for v in State::<2>::initial(&scene).velocities {
        for x in v.0 {
            let drawn: f64 = generator.sample(StandardNormal);
            assert_eq!(x.to_bits(), (scene.initial.velocity * drawn).to_bits());
        }
    }
}

#[test]
fn taylor_green_and_abc_have_no_divergence_and_the_energy_of_their_formula() {
    // Differences of a sine are the sine times one factor, so that only round-off is left.
    let flat = State::<2>::initial(&scene::<2>(16, "taylor-green")).velocities;
    let deep = State::<3>::initial(&scene::<3>(12, "{kind='taylor-green'}")).velocities;
    let abc = State::<3>::initial(&scene::<3>(12, "{kind='abc',a=1,b=0.5,c=0.25}")).velocities;
    assert!(divergence(16, &flat) < 1e-13);
    assert!(divergence(12, &deep) < 1e-13);
    assert!(divergence(12, &abc) < 1e-13);
    let square = 0.7 * 0.7;
    assert!((mean_square(&flat) - square / 2.0).abs() < 1e-14);
    assert!((mean_square(&deep) - square / 4.0).abs() < 1e-14);
    assert!((mean_square(&abc) - square * (1.0 + 0.25 + 0.0625)).abs() < 1e-14);
}

#[test]
fn taylor_green_turns_as_the_formula_says() {
    let quarter = 4; // of 16: kx = π/2
    let flat = State::<2>::initial(&scene::<2>(16, "taylor-green"));
    assert!((flat.velocities[quarter] - Vector([0.7, 0.0])).norm() < 1e-15);
    assert!((flat.velocities[16 * quarter] - Vector([0.0, -0.7])).norm() < 1e-15);
}

#[test]
fn the_abc_flow_is_a_beltrami_flow() {
    let n = 12;
    let u = State::<3>::initial(&scene::<3>(n, "abc")).velocities;
    let k = std::f64::consts::TAU / 3.0;
    // A central difference of a wave with |n| = 1 is its derivative times sin(kΔ)/(kΔ).
    let spacing = 3.0 / n as f64;
    let factor = (k * spacing).sin() / spacing;
    let index = |x: [usize; 3]| x[0] % n + n * (x[1] % n) + n * n * (x[2] % n);
    let by = |x: [usize; 3], axis: usize, component: usize| {
        let (mut next, mut before) = (x, x);
        (next[axis], before[axis]) = (x[axis] + 1, x[axis] + n - 1);
        (u[index(next)][component] - u[index(before)][component]) / (2.0 * spacing)
    };
    for x in [[0, 0, 0], [3, 1, 7], [11, 5, 2]] {
        let curl = Vector(std::array::from_fn(|axis| {
            let (second, third) = ((axis + 1) % 3, (axis + 2) % 3);
            by(x, second, third) - by(x, third, second)
        }));
        assert!((curl - u[index(x)] * factor).norm() < 1e-13, "at {x:?}");
    }
}

fn follows_its_spectrum<const D: usize>(per_side: usize, field: &str) {
    let scene = scene::<D>(per_side, field);
    let Field::RandomSolenoidal(random) = &scene.initial.field else { panic!("{field}") };
    let velocities = State::<D>::initial(&scene).velocities;
    let mesh = Mesh::cube(3.0, per_side);
    let found = energy_spectrum(&mesh, &velocities);
    let mut asked: Vec<f64> =
        random.spectrum.energies(D).into_iter().map(|e| 0.7 * 0.7 * e).collect();
    asked.resize(found.len(), 0.0);
    // Every wave is a mode of the mesh: the difference is only the round-off of two transforms.
    for (k, (found, asked)) in found.iter().zip(&asked).enumerate() {
        assert!((found - asked).abs() < 1e-13, "{field}, E({k}): {found}, asked {asked}");
    }
    assert!((mean_square(&velocities) - D as f64 * 0.7 * 0.7).abs() < 1e-12);
}

#[test]
fn a_random_solenoidal_field_has_the_spectrum_and_the_rms_that_were_asked() {
    for field in [VON_KARMAN, POWER_LAW, BAND] {
        follows_its_spectrum::<2>(16, field);
        follows_its_spectrum::<3>(11, field);
    }
}

#[test]
fn a_von_karman_spectrum_is_largest_at_its_peak_and_falls_as_five_thirds() {
    let energies = Spectrum::VonKarman { peak: 3.0, largest: 64 }.energies(3);
    assert!(energies[2] < energies[3] && energies[3] > energies[4]);
    let slope = (energies[64] / energies[32]).log2();
    assert!((slope + 5.0 / 3.0).abs() < 0.02, "{slope}");
    assert!((energies.iter().sum::<f64>() - 1.5).abs() < 1e-14);
}

#[test]
fn no_wave_of_a_random_solenoidal_field_has_divergence() {
    for scene in [scene::<2>(16, VON_KARMAN), scene::<3>(11, VON_KARMAN)] {
        let Field::RandomSolenoidal(random) = &scene.initial.field else { panic!() };
        for wave in random.waves(&scene).list() {
            for amplitude in [wave.cosine, wave.sine] {
                let along: f64 = (0..3).map(|a| f64::from(wave.n[a]) * amplitude[a]).sum();
                assert!(along.abs() < 1e-15, "{wave:?}");
            }
        }
    }
}

#[test]
fn the_seed_changes_a_random_solenoidal_field_and_the_number_of_threads_does_not() {
    let mut scene = scene::<3>(11, VON_KARMAN);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| State::<3>::initial(&scene))
    };
    let (one, three) = (with(1), with(3));
    assert_eq!(one, three);
    scene.seed += 1;
    assert_ne!(State::<3>::initial(&scene), one);
}

#[test]
fn more_particles_and_more_waves_keep_the_long_waves() {
    let random = |scene: &Scene| {
        let Field::RandomSolenoidal(random) = &scene.initial.field else { panic!() };
        random.waves(scene)
    };
    let coarse = random(&scene::<3>(11, BAND));
    let finer = random(&scene::<3>(22, &BAND.replace("largest=3", "largest=6")));
    let both = coarse.list().iter().zip(finer.list());
    for (coarse, finer) in both {
        let scale = Vector(finer.cosine).norm() / Vector(coarse.cosine).norm();
        let other = Vector(finer.sine) - Vector(coarse.sine) * scale;
        assert!(coarse.n == finer.n && other.norm() < 1e-14, "{coarse:?}, {finer:?}");
    }
}

#[test]
fn velocities_are_those_at_the_shaken_places() {
    let mut scene = scene::<2>(16, "taylor-green");
    scene.initial.jitter = 0.05;
    let state = State::<2>::initial(&scene);
    let k = std::f64::consts::TAU / 3.0;
    for (r, v) in state.positions.iter().zip(&state.velocities) {
        let expected = 0.7 * (k * r[0]).sin() * (k * r[1]).cos();
        assert!((v[0] - expected).abs() < 1e-14);
    }
    assert_eq!(state.positions, {
        scene.initial.field = Field::default();
        State::<2>::initial(&scene).positions
    });
}
