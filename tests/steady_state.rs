//! A flow in a steady state allocates no more memory.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

#[path = "common/counting.rs"]
mod counting;

use counting::ASKED;
use std::sync::atomic::Ordering;
use whirls::systems::neighbours::Neighbours;
use whirls::{Flow, Scene};

/// Number of allocations in 40 steps of a developed flow, and number of rebuilds of the lists.
fn asked<const D: usize>(name: &str, more: &[&str]) -> (usize, u64) {
    let more: Vec<String> = more.iter().map(|&text| text.to_owned()).collect();
    let scene = Scene::open(name, &more).unwrap();
    let mut flow = Flow::<D>::new(&scene).unwrap();
    let rebuilds = |flow: &Flow<D>| flow.world().resource::<Neighbours<D>>().rebuilds;
    let mut found = (0, 0);
    // A thread that is starting allocates memory of its own, so that all threads must have worked
    // once.
    rayon::broadcast(|_| ());
    // On a thread of the pool: a call from outside of the pool allocates a box for its closure.
    rayon::scope(|_| {
        (0..20).for_each(|_| flow.step().unwrap());
        let before = (ASKED.load(Ordering::Relaxed), rebuilds(&flow));
        (0..40).for_each(|_| flow.step().unwrap());
        found = (ASKED.load(Ordering::Relaxed) - before.0, rebuilds(&flow) - before.1);
    });
    println!("{name} {more:?}: asked {} times in 40 steps with {} builds", found.0, found.1);
    found
}

/// One test, because allocations of another test at the same time would be counted, too.
#[test]
fn a_flow_that_has_found_its_memory_allocates_nothing_in_a_step() {
    let mixed = "precision='mixed'";
    let ou = "forcing={kind='ornstein-uhlenbeck',power=0.1,correlation_time=0.5,band=2.5}";
    let step = "time.step='kick-drift-kick'";
    for (asked, builds) in [
        asked::<2>("inverse-2d", &[]),
        asked::<3>("inverse-3d", &[]),
        asked::<3>("inverse-3d", &[step, mixed]),
        asked::<3>("inverse-3d", &["forcing={kind='none'}"]),
        asked::<3>("inverse-3d", &["forcing={kind='stochastic',interval=0.05,strength=1.0}"]),
        asked::<2>("inverse-2d", &[ou]),
    ] {
        assert!(builds > 4, "the lists were built anew");
        assert_eq!(asked, 0);
    }
}
