//! Precision of pair evaluations: every instruction set gives the same bits, and mixed precision is
//! as accurate as single precision can be, and conserves momentum as double precision does.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::{in_2d_and_3d, shaken};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use whirls::flow::State;
use whirls::learn::Learner;
use whirls::models::Medium;
use whirls::network::{exp, tanh};
use whirls::packed::{Packed, PackedAdjoint, PackedSingle};
use whirls::pairs::{Batch, Eight, Lines, ListBuilder, Surroundings, adjoints, separation};
use whirls::scalar::{F64x8, Precision, SimdFloat, SimdTask, WIDTH, on_every_instruction_set};
use whirls::scene::Scene;
use whirls::sensitivity::Gradient;
use whirls::systems::verlet::Step;
use whirls::truth::Truth;
use whirls::vector::Vector;
use whirls::{Error, Flow};

in_2d_and_3d!(
    every_instruction_set_gives_the_bits_of_the_plain_one,
    mixed_accelerations_are_those_of_single_precision,
    mixed_precision_conserves_momentum_as_double_precision_does,
    mixed_flows_have_the_same_bits_for_any_number_of_threads,
    mixed_precision_makes_no_lost_number_of_particles_in_one_place,
    mixed_gradients_agree_with_each_other_and_with_double_precision,
);

/// All operations of pair loops, as one list of bits.
#[derive(Clone)]
struct Everything<'a, const D: usize> {
    lines: Lines<'a>,
    adjoint: &'a [PackedAdjoint],
    medium: &'a Medium<D>,
    slots: &'a [[u32; WIDTH]],
    columns: &'a [Vec<i32>; D],
    length: f64,
}

impl<const D: usize> SimdTask for Everything<'_, D> {
    type Output = Vec<u64>;

    #[inline(always)]
    fn run<W: SimdFloat>(self) -> Vec<u64> {
        let space = whirls::space::Space::cube(self.length);
        let space = Surroundings { space, seam: true };
        let mut bits = Vec::new();
        let mut put = |x: F64x8| bits.extend(x.to_array().map(f64::to_bits));
        let mut chunk = ListBuilder::default();
        chunk.clear();
        for (here, slots) in self.slots.iter().enumerate() {
            let slots = Eight::from(slots);
            let r = separation::<W, D>(self.lines, here, slots, space);
            put(self.medium.smoothing.value(r.norm_squared().sqrt()).store());
            let batch = Batch::<W, D>::read(self.lines, here, slots, space);
            let slope = self.medium.slope(&batch);
            let force = self.medium.force(&batch);
            for axis in 0..D {
                put(r[axis].store());
                put(force[axis].widen().store());
                put(slope.by_separation[axis].store());
                put(slope.by_velocity[axis].store());
                put(batch.direction()[axis].store());
            }
            adjoints::<W>(self.adjoint, slots).into_iter().for_each(|x| put(x.store()));
            slope.by_parameter.into_iter().for_each(|x| put(x.store()));
            let x = W::Double::load(&batch.p_over_rho2_j.store());
            put(tanh(x).store());
            put(exp(-x.abs()).store());
            put(W::narrow(x).copysign(-batch.p_over_rho2_j).store());
            chunk.open(3 * WIDTH);
            let [near, maybe] = W::near(self.columns, [7_000_000; D], here, [1e18, 2e18]);
            chunk.append_mask::<W>(near ^ maybe.rotate_left(3), here);
            chunk.close(0, false);
            put(F64x8::new([r.norm_squared().widen().sum(); WIDTH]));
        }
        chunk.finish();
        let lists = (0..chunk.len()).flat_map(|k| chunk.neighbours(k).as_flattened());
        bits.extend(lists.map(|&slot| u64::from(slot)));
        bits
    }
}

fn every_instruction_set_gives_the_bits_of_the_plain_one<const D: usize>() {
    let scene = common::scene::<D>(8);
    let (medium, length) = (Medium::<D>::of(&scene, scene.particles()), scene.fluid.box_length);
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut number = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    let mut double: Vec<Packed> = (0..64)
        .map(|_| Packed {
            position: std::array::from_fn(|axis| if axis < D { number(0.0, length) } else { 0.0 }),
            velocity: std::array::from_fn(|axis| if axis < D { number(-2.0, 2.0) } else { 0.0 }),
            density: number(0.5, 1.5),
            p_over_rho2: number(-3.0, 3.0),
        })
        .collect();
    // Close pairs, coincident particles, and the periodic boundary.
    double[1] = Packed { position: double[0].position, ..double[1] };
    double[2].position = double[0].position.map(|x| (x + 0.1) % length);
    double[3].position = [length * (1.0 - 1e-16), 0.0, 0.0];
    let space = common::space(&scene);
    let mut single: Vec<_> = double.iter().map(|line| PackedSingle::new(line, space)).collect();
    double.push(Packed::SENTINEL);
    single.push(PackedSingle::SENTINEL);
    let adjoint: Vec<_> = (0..65)
        .map(|_| PackedAdjoint { force: [0.0; 3].map(|_| number(-1.0, 1.0)), density: 0.25 })
        .collect();
    let slots: Vec<[u32; WIDTH]> = (0..16)
        .map(|here| std::array::from_fn(|l| if l == 6 { 64 } else { (here * l + l) as u32 % 64 }))
        .collect();
    let columns: [Vec<i32>; D] =
        std::array::from_fn(|axis| single.iter().map(|p| p.position[axis]).collect());
    for precision in Precision::ALL {
        let lines = Lines { double: &double, single: &single, precision };
        let (adjoint, medium, slots) = (&adjoint[..], &medium, &slots[..]);
        let pass = Everything { lines, adjoint, medium, slots, columns: &columns, length };
        let found = on_every_instruction_set(precision, &pass);
        let names: Vec<_> = found.iter().map(|(name, _)| *name).collect();
        println!("{D}D, {}: {}", precision.name(), names.join(", "));
        for (name, bits) in &found[1..] {
            let differ = bits.iter().zip(&found[0].1).position(|(a, b)| a != b);
            assert_eq!((differ, bits.len()), (None, found[0].1.len()), "{name}, {precision:?}");
        }
    }
}

/// A flow in each precision, started at the same state.
fn both<const D: usize>(scene: &Scene, state: &State<D>) -> [Flow<D>; 2] {
    Precision::ALL.map(|precision| {
        let mut scene = scene.clone();
        scene.precision = precision;
        common::started(&scene, state)
    })
}

fn mixed_accelerations_are_those_of_single_precision<const D: usize>() {
    let scene = common::scene::<D>(if D == 2 { 24 } else { 12 });
    let [mut double, mut mixed] = both::<D>(&scene, &shaken(&scene));
    let (exact, found) = (double.accelerations(), mixed.accelerations());
    let size = common::largest(exact.iter().map(|a| a.norm()));
    let error = common::farthest(&exact, &found) / size;
    let rho = double.densities().into_iter().zip(mixed.densities());
    let density = common::largest(rho.map(|(a, b)| (a - b).abs()));
    println!(
        "{D}D: accelerations differ by {error:.1e} of the largest, densities by {density:.1e}"
    );
    // About a dozen rounding errors of 6e-8 in each of some twenty terms; and not equal to double
    // precision.
    assert!((1e-9..3e-6).contains(&error) && (1e-9..1e-6).contains(&density), "{error} {density}");
}

fn mixed_precision_conserves_momentum_as_double_precision_does<const D: usize>() {
    let scene = common::scene::<D>(if D == 2 { 24 } else { 12 });
    for flow in &mut both::<D>(&scene, &shaken(&scene)) {
        (0..50).for_each(|_| flow.step().unwrap());
        let rates = flow.momentum_rates();
        let rate = (rates.pressure.norm() + rates.viscosity.norm()) / rates.scale;
        println!("{D}D: Σ m a is {rate:.1e} of Σ m |a|");
        assert!(rate < 1e-14, "{rate}");
    }
}

fn mixed_flows_have_the_same_bits_for_any_number_of_threads<const D: usize>() {
    let mut scene = common::scene::<D>(if D == 2 { 24 } else { 12 });
    scene.precision = Precision::Mixed;
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut flow = common::started::<D>(&scene, &shaken(&scene));
            common::after(&mut flow, 20)
        })
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(one, three);
}

fn mixed_precision_makes_no_lost_number_of_particles_in_one_place<const D: usize>() {
    let mut scene = common::scene::<D>(8);
    scene.precision = Precision::Mixed;
    scene.limits.courant = f64::MAX;
    for kernel in common::KERNELS {
        scene.fluid.kernel = kernel;
        for apart in [0.0, 1e-300, 1e-30, 1e-12, 1e-9, 3e-9] {
            let mut state = shaken::<D>(&scene);
            state.positions[1] = state.positions[0];
            state.positions[1][0] += apart;
            state.positions[2] = Vector::zero();
            state.positions[3] = Vector([scene.fluid.box_length * (1.0 - 1e-16); D]);
            let mut flow = common::started(&scene, &state);
            assert!(flow.accelerations().iter().all(|a| a.is_finite()), "{kernel:?}, {apart:e}");
            for _ in 0..20 {
                match flow.step() {
                    Ok(()) => assert!(flow.state().positions.iter().all(|r| r.is_finite())),
                    Err(Error::Diverged { .. }) => break,
                    Err(other) => panic!("{other}"),
                }
            }
        }
    }
}

/// The gradient of a scene's loss off the truth.
fn gradient<const D: usize>(scene: &Scene, precision: Precision, way: Gradient) -> Vec<f64> {
    // The truth is the same in both.
    let truth = {
        let learn = scene.learning().unwrap();
        Truth::<D>::generate(scene, (learn.after, learn.frames)).unwrap()
    };
    let mut scene = scene.clone();
    scene.precision = precision;
    if let Some(learn) = &mut scene.learn {
        learn.gradient = way;
    }
    let mut learner = Learner::of_truth(&scene, &truth).unwrap();
    let guess = [8.0, 0.7, 2.6, 5.0];
    learner.evaluate(&guess, scene.learning().unwrap().frames).unwrap().gradient
}

fn mixed_gradients_agree_with_each_other_and_with_double_precision<const D: usize>() {
    let name = if D == 2 { "inverse-2d" } else { "inverse-3d" };
    let (side, h) = if D == 2 { (14, 0.457) } else { (8, 0.67) };
    let overrides = [
        format!("fluid.particles_per_side={side}"),
        format!("fluid.smoothing_length={h}"),
        "learn.after=4".to_owned(),
        "learn.frames=5".to_owned(),
        "learn.windows=[]".to_owned(),
        "learn.optimiser={kind='adam',rate=0.1}".to_owned(),
    ];
    let mut scene = Scene::open(name, &overrides).unwrap();
    for step in [Step::KickDriftKick, Step::Paper] {
        scene.time.step = step;
        let exact = gradient::<D>(&scene, Precision::Double, Gradient::Adjoint);
        let ways = [Gradient::Forward, Gradient::Adjoint];
        let [forward, adjoint] = ways.map(|way| gradient::<D>(&scene, Precision::Mixed, way));
        let largest = common::largest(exact.iter().map(|g| g.abs()));
        let apart = |a: &[f64], b: &[f64]| {
            common::largest(a.iter().zip(b).map(|(a, b)| (a - b).abs())) / largest
        };
        let (ways, precisions) = (apart(&forward, &adjoint), apart(&adjoint, &exact));
        println!(
            "{D}D, {}: forward and adjoint differ by {ways:.1e}, mixed and double by {precisions:.1e}",
            step.name()
        );
        assert!(ways < 1e-5 && precisions < 1e-4 && precisions > 1e-12, "{ways} {precisions}");
    }
}
