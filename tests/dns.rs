//! What the spectral solver promises: exact solutions, conservation, orders of convergence, equal bits.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use std::f64::consts::TAU;
use whirls::dns::{Forcing, Modes, Scheme, Settings, Solver, Start, StepSize, Truncation};
use whirls::flow::initial::{Abc, Spectrum};
use whirls::forcing::ornstein_uhlenbeck::Settings as Stochastic;
use whirls::vector::Vector;

fn random<const D: usize>(largest: i64, seed: u64) -> Start<D> {
    let spectrum = Spectrum::VonKarman { peak: 2.0, largest };
    Start::RandomSolenoidal { spectrum, velocity: 0.8, seed }
}

fn solver<const D: usize>(settings: Settings, start: &Start<D>) -> Solver<D> {
    Solver::new(settings, start).unwrap()
}

/// rms over nodes.
fn rms<const D: usize>(field: impl ExactSizeIterator<Item = Vector<f64, D>>) -> f64 {
    let count = field.len() as f64;
    (field.map(Vector::norm_squared).sum::<f64>() / count).sqrt()
}

fn apart<const D: usize>(one: &[Vector<f64, D>], other: &[Vector<f64, D>]) -> f64 {
    rms(one.iter().zip(other).map(|(&a, &b)| a - b)) / rms(one.iter().copied())
}

#[test]
fn abc_flow_decays_as_theory_says() {
    let start = Start::<3>::Abc { shape: Abc { a: 1.0, b: 0.7, c: 0.4 }, velocity: 1.0 };
    let length = 3.0;
    let mut flow = solver(Settings { length, ..Settings::new(16, 0.05) }, &start);
    let before = flow.velocity();
    flow.advance_to(2.0).unwrap();
    let factor = (-0.05 * (TAU / length).powi(2) * 2.0_f64).exp();
    let expected: Vec<_> = before.iter().map(|&u| u * factor).collect();
    // The advection of a Beltrami flow is a gradient: only round-off is left, whatever the step.
    let error = apart(&expected, &flow.velocity());
    println!("after {} steps: {error:.1e}", flow.steps());
    assert!(error < 1e-13, "{error:e}");
}

#[test]
fn taylor_green_vortex_in_two_dimensions_decays_as_theory_says() {
    let mut flow = solver::<2>(Settings::new(32, 0.03), &Start::TaylorGreen { velocity: 1.3 });
    let before = flow.velocity();
    flow.advance_to(3.0).unwrap();
    let expected: Vec<_> = before.iter().map(|&u| u * (-2.0 * 0.03 * 3.0_f64).exp()).collect();
    let error = apart(&expected, &flow.velocity());
    assert!(error < 1e-13, "{error:e}");
}

/// The error at time 0.5 of a flow with advection, forcing and tracers, of fields and of positions.
fn errors<const D: usize>(
    scheme: Scheme,
    dt: f64,
    exact: &mut Option<[Vec<Vector<f64, D>>; 2]>,
) -> [f64; 2] {
    let settings = Settings {
        scheme,
        step_size: StepSize::Fixed(dt),
        forcing: Forcing::Band { power: 0.3, band: 2.5 },
        ..Settings::new(24, 0.02)
    };
    let mut flow = solver::<D>(settings, &random(6, 3));
    flow.seed(&[0.3, 1.9, 4.4].map(|x| Vector::from_3d([x, 2.0 - 0.3 * x, 0.8 * x])));
    flow.advance_to(0.5).unwrap();
    let found = [flow.velocity(), flow.tracers()];
    let exact = exact.get_or_insert_with(|| found.clone());
    [apart(&exact[0], &found[0]), apart(&exact[1], &found[1])]
}

fn has_its_order<const D: usize>() {
    let mut exact = None;
    errors::<D>(Scheme::Classical, 0.5 / 160.0, &mut exact);
    for scheme in [Scheme::Heun, Scheme::Third, Scheme::Classical] {
        let [coarse, fine] = [10.0, 20.0].map(|n| errors::<D>(scheme, 0.5 / n, &mut exact));
        for (what, coarse, fine) in [("field", coarse[0], fine[0]), ("tracers", coarse[1], fine[1])]
        {
            let order = (coarse / fine).log2();
            println!("{D}D {scheme:?} {what}: {coarse:.1e} {fine:.1e}, order {order:.2}");
            assert!((order - f64::from(scheme.order())).abs() < 0.35);
        }
    }
}

#[test]
fn field_and_tracers_converge_by_the_order_of_the_scheme() {
    has_its_order::<2>();
    has_its_order::<3>();
}

const ALL_FORCINGS: [Forcing; 5] = [
    Forcing::None,
    Forcing::Linear { rate: 0.28 },
    Forcing::LinearPower { power: 0.4 },
    Forcing::Band { power: 0.4, band: 2.5 },
    Forcing::OrnsteinUhlenbeck {
        settings: Stochastic { power: 0.4, correlation_time: 0.5, band: 2.5 },
        interval: 0.05,
        seed: 4,
    },
];

#[test]
fn energy_changes_by_power_less_dissipation() {
    for forcing in ALL_FORCINGS {
        let settings =
            Settings { forcing, step_size: StepSize::Fixed(0.005), ..Settings::new(24, 0.05) };
        let mut flow = solver::<3>(settings, &random(6, 1));
        flow.advance_to(0.1).unwrap();
        // Boole's rule over four steps: an error of dt⁶; forces that are drawn are linear in between.
        let (mut energies, mut rates) = (Vec::new(), Vec::new());
        for _ in 0..5 {
            let found = flow.statistics();
            energies.push(found.energy);
            rates.push(found.power - found.dissipation);
            flow.step().unwrap();
        }
        let mean =
            [7.0, 32.0, 12.0, 32.0, 7.0].iter().zip(&rates).map(|(w, r)| w * r).sum::<f64>() / 90.0;
        let found = (energies[4] - energies[0]) / 0.02;
        let error = (found - mean).abs() / rates[0].abs().max(0.1);
        println!("{forcing:?}: dE/dt {found:.8}, P − ε {mean:.8}, {error:.1e}");
        // The energy carries the error of the scheme, dt⁴.
        assert!(error < 1e-7, "{error:e}");
    }
}

#[test]
fn forcings_of_given_power_inject_it_and_leave_the_mean_alone() {
    for forcing in ALL_FORCINGS {
        let mut flow = solver::<3>(Settings { forcing, ..Settings::new(16, 0.05) }, &random(4, 1));
        let power = flow.statistics().power;
        match forcing {
            Forcing::LinearPower { power: asked } | Forcing::Band { power: asked, .. } => {
                assert!((power - asked).abs() < 1e-14, "{power}");
            }
            Forcing::Linear { rate } => {
                assert!((power - 2.0 * rate * flow.statistics().energy).abs() < 1e-14);
            }
            _ => {}
        }
        flow.step().unwrap();
        assert!(flow.modes().coefficient([0; 3]).iter().flatten().all(|x| x.abs() < 1e-16));
    }
}

fn stays_free_of_divergence<const D: usize>() {
    let both = [Truncation::Cube, Truncation::Sphere];
    for (forcing, truncation) in ALL_FORCINGS.into_iter().flat_map(|f| both.map(|t| (f, t))) {
        let settings = Settings { forcing, truncation, ..Settings::new(24, 0.03) };
        let mut flow = solver::<D>(settings, &random(6, 2));
        flow.advance_to(0.5).unwrap();
        let divergence = flow.modes().divergence();
        println!("{D}D, {truncation:?}, {forcing:?}: {divergence:.1e}");
        assert!(divergence < 1e-12);
    }
}

#[test]
fn velocity_stays_free_of_divergence() {
    stays_free_of_divergence::<2>();
    stays_free_of_divergence::<3>();
}

fn uniform_motion_shifts<const D: usize>() {
    let mut settings = Settings { step_size: StepSize::Fixed(0.005), ..Settings::new(24, 0.03) };
    settings.forcing = Forcing::Linear { rate: 0.28 };
    let mut rest = solver::<D>(settings, &random(6, 5));
    let shift = Vector::from_3d([0.7, -0.4, 0.2]);
    let values = rest.velocity().iter().map(|&u| u + shift).collect();
    let mut moving = solver(settings, &Start::Values(values));
    let places = [0.1, 2.3, 5.1].map(|x| Vector::from_3d([x, x * 0.7, 3.0 - x * 0.5]));
    rest.advance_to(0.5).unwrap();
    moving.advance_to(0.5).unwrap();
    for x in places {
        let there = moving.modes().velocity_at(x + shift * 0.5) - shift;
        let error = (there - rest.modes().velocity_at(x)).norm();
        println!("{D}D: {error:.1e}");
        // The scheme sees other Courant numbers: dt⁴ (k u)⁴.
        assert!(error < 1e-6, "{error:e}");
    }
}

#[test]
fn a_uniform_motion_shifts_the_flow_and_changes_nothing_else() {
    uniform_motion_shifts::<2>();
    uniform_motion_shifts::<3>();
}

#[test]
fn refining_keeps_the_flow() {
    let mut coarse = solver::<3>(Settings::new(24, 0.05), &random(6, 2));
    coarse.advance_to(0.3).unwrap();
    let fine = solver(Settings::new(48, 0.05), &Start::Modes(coarse.modes().clone()));
    let x = Vector([0.7, 2.1, 5.5]);
    let error = (fine.modes().velocity_at(x) - coarse.modes().velocity_at(x)).norm();
    assert!(error < 1e-14, "{error:e}");
    let back: Modes<3> =
        solver(Settings::new(24, 0.05), &Start::Modes(fine.modes().clone())).modes().clone();
    assert!((back.velocity_at(x) - coarse.modes().velocity_at(x)).norm() < 1e-14);
}

fn splines_are_exact_at_nodes<const D: usize>() {
    for spline_degree in [5, 7, 9] {
        let settings = Settings { spline_degree, length: 2.0, ..Settings::new(24, 0.05) };
        let mut flow = solver::<D>(settings, &random(7, 2));
        let mesh = whirls::losses::Mesh::<D>::cube(2.0, 24);
        let nodes: Vec<_> = (0..mesh.len()).map(|index| mesh.node(index)).collect();
        flow.seed(&nodes);
        let error = apart(&flow.velocity(), &flow.tracer_velocities());
        let inside: Vec<_> =
            nodes.iter().map(|&x| x + Vector::from_3d([0.031, 0.044, 0.052])).collect();
        flow.seed(&inside);
        let between = flow.spline_error(200);
        println!("{D}D degree {spline_degree}: {error:.1e} at nodes, {between:.1e} between");
        assert!(error < 1e-13 && between < 1e-2);
    }
}

#[test]
fn splines_are_exact_at_nodes_and_their_error_between_is_told() {
    splines_are_exact_at_nodes::<2>();
    splines_are_exact_at_nodes::<3>();
}

#[test]
fn accelerations_are_the_change_of_velocity_along_tracers() {
    for forcing in [ALL_FORCINGS[1], ALL_FORCINGS[4]] {
        let settings = Settings { forcing, spline_degree: 9, ..Settings::new(32, 0.1) };
        let settings = Settings { step_size: StepSize::Fixed(0.002), ..settings };
        let mut flow = solver::<3>(settings, &random(5, 2));
        let at = |i: usize| Vector([0.31, 0.77, 1.9].map(|x| x * i as f64));
        flow.seed(&(0..50).map(at).collect::<Vec<_>>());
        // The start has waves up to 5, so that the mesh keeps all of u·∇u; later it leaves some of it out.
        let before = flow.tracer_velocities();
        flow.advance_to(0.0005).unwrap();
        let acceleration = flow.tracer_accelerations();
        flow.advance_to(0.001).unwrap();
        let after = flow.tracer_velocities();
        let slopes: Vec<_> =
            before.iter().zip(&after).map(|(&a, &b)| (b - a) * (1.0 / 0.001)).collect();
        let size = acceleration.iter().map(|a| a.norm()).fold(0.0, f64::max);
        let error = apart(&acceleration, &slopes) / size;
        println!("{forcing:?}: {error:.1e} of the largest, {size:.2}");
        // Central differences have an error of dt² ü/6, and waves beyond the mesh take their share.
        assert!(error < 1e-3, "{error:e}");
    }
}

#[test]
fn filtered_velocity_is_the_velocity_times_the_transform_of_the_kernel() {
    use whirls::kernel::{CubicSpline, Transform};
    let mut flow = solver::<3>(Settings::new(24, 0.05), &random(6, 2));
    let (kernel, h) = (Transform::of(&CubicSpline, 3), 0.45);
    let filtered = flow.filtered_modes(&kernel, h);
    for n in [[1, 2, 0], [-3, 1, 2], [0, -2, 1]] {
        let length = n.iter().map(|&n| f64::from(n * n)).sum::<f64>().sqrt();
        let (one, all) = (filtered.coefficient(n), flow.modes().coefficient(n));
        for (one, all) in one.iter().flatten().zip(all.iter().flatten()) {
            assert!((one - all * kernel.at(h * length)).abs() < 1e-15);
        }
    }
    // A spacing of L/24 is 12 nodes a half-width: sums over nodes are integrals to the kernel's smoothness.
    let fields = [flow.filtered(&kernel, h), flow.nodal(&filtered)];
    assert_eq!(fields[0], fields[1]);
    // Every third node of 24 is a node of 8; 5 nodes are every sixth of 30.
    let coarse = flow.filtered_on((&kernel, h), 8).unwrap();
    let error = (coarse[1 + 8 * (2 + 8 * 3)] - fields[0][3 + 24 * (6 + 24 * 9)]).norm();
    assert!(error < 1e-15, "{error:e}");
    let other = flow.filtered_on((&kernel, h), 5).unwrap();
    let x = Vector([1.0, 2.0, 4.0]) * (TAU / 5.0);
    let error = (other[1 + 5 * (2 + 5 * 4)] - filtered.velocity_at(x)).norm();
    assert!(error < 1e-14, "{error:e}");
}

fn bits<const D: usize>(threads: usize, forcing: Forcing) -> [Vec<u64>; 2] {
    let run = || {
        let mut flow = solver::<D>(Settings { forcing, ..Settings::new(24, 0.03) }, &random(6, 2));
        let at = |i: usize| Vector::from_3d([0.31, 0.77, 1.9].map(|x| x * i as f64));
        flow.seed(&(0..300).map(at).collect::<Vec<_>>());
        (0..4).for_each(|_| assert!(flow.step().unwrap() > 0.0));
        [flow.velocity(), flow.tracers()]
            .map(|all| all.iter().flat_map(|u| u.0).map(f64::to_bits).collect())
    };
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(run)
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    for forcing in ALL_FORCINGS {
        for threads in [2, 3] {
            assert_eq!(bits::<2>(1, forcing), bits::<2>(threads, forcing));
            assert_eq!(bits::<3>(1, forcing), bits::<3>(threads, forcing));
        }
    }
}

#[test]
fn wrong_numbers_are_refused_with_what_to_do() {
    let rest = Start::<3>::TaylorGreen { velocity: 1.0 };
    let refused = |settings: Settings, start: &Start<3>| {
        Solver::new(settings, start).unwrap_err().to_string()
    };
    for (nodes, word) in [(14, "nodes"), (33, "nodes"), (4, "nodes")] {
        assert!(refused(Settings::new(nodes, 0.1), &rest).contains(word));
    }
    assert!(refused(Settings::new(16, -0.1), &rest).contains("viscosity"));
    assert!(refused(Settings::new(16, f64::NAN), &rest).contains("viscosity"));
    let spline_degree = 4;
    assert!(
        refused(Settings { spline_degree, ..Settings::new(16, 0.1) }, &rest).contains("5, 7 or 9")
    );
    let values = Start::Values(vec![Vector::zero(); 17]);
    assert!(refused(Settings::new(16, 0.1), &values).contains("whole mesh"));
    let mut flow = solver::<3>(Settings::new(16, 1e-4), &rest);
    assert!(flow.statistics().check_resolution().unwrap_err().to_string().contains("k_max"));
    let flat = Solver::<2>::new(
        Settings::new(16, 0.1),
        &Start::Abc { shape: Abc::default(), velocity: 1.0 },
    );
    assert!(flat.unwrap_err().to_string().contains("dimension 2"));
}

#[test]
fn a_step_that_is_far_too_long_is_reported() {
    let settings = Settings { step_size: StepSize::Fixed(5.0), ..Settings::new(16, 1e-4) };
    let mut flow = solver::<3>(settings, &random(5, 1));
    let error = (0..200).find_map(|_| flow.step().err()).unwrap();
    assert!(error.to_string().contains("Courant"), "{error}");
}
