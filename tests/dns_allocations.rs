//! A step of the spectral solver allocates nothing.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

#[path = "common/counting.rs"]
mod counting;

use counting::ASKED;
use std::sync::atomic::Ordering;
use whirls::dns::{Forcing, Settings, Solver, Start};
use whirls::forcing::ornstein_uhlenbeck::Settings as Stochastic;
use whirls::vector::Vector;

#[test]
fn a_step_allocates_nothing() {
    let stochastic = Stochastic { power: 0.4, correlation_time: 0.5, band: 2.5 };
    let forcings = [
        Forcing::Band { power: 0.4, band: 2.5 },
        Forcing::OrnsteinUhlenbeck { settings: stochastic, interval: 0.001, seed: 4 },
    ];
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| {
        for forcing in forcings {
            let settings = Settings { forcing, ..Settings::new(24, 0.03) };
            let start = Start::TaylorGreen { velocity: 1.0 };
            let mut flow = Solver::<3>::new(settings, &start).unwrap();
            flow.seed(&[Vector([1.0, 2.0, 3.0]); 200]);
            flow.step().unwrap();
            let before = ASKED.load(Ordering::Relaxed);
            (0..5).for_each(|_| assert!(flow.step().unwrap() > 0.0));
            assert_eq!(ASKED.load(Ordering::Relaxed), before, "{forcing:?}");
        }
    });
}
