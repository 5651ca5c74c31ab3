//! The engine against a flow that others computed and published.
use std::path::Path;
use whirls::flow::State;
use whirls::vector::Vector;
use whirls::{Flow, Scene};

fn read(name: &str) -> Option<(Vec<u64>, Vec<f64>)> {
    let path = Path::new("../shared/data/woodward-2d").join(name);
    let bytes = std::fs::read(path).ok()?;
    let npy = npyz::NpyFile::new(&bytes[..]).unwrap();
    let shape = npy.shape().to_vec();
    // Fortran order as stored: the first index runs fastest.
    assert_eq!(npy.order(), npyz::Order::Fortran);
    Some((shape, npy.into_vec::<f64>().unwrap()))
}

#[test]
fn all_fifteen_next_frames_match() {
    let Some((shape, r)) = read("positions.npy") else {
        println!("skipped: no data");
        return;
    };
    let (_, v) = read("velocities.npy").unwrap();
    let (_, rho) = read("densities.npy").unwrap();
    let (f, n) = (shape[0] as usize, shape[1] as usize);
    let at =
        |a: &Vec<f64>, k: usize, i: usize| Vector::<f64, 2>([a[k + f * i], a[k + f * (i + n)]]);
    let mut scene = Scene::shipped("inverse-2d").unwrap();
    scene.time.skin = 0.2;
    let state = |k: usize| State {
        time: 0.0,
        positions: (0..n).map(|i| at(&r, k, i)).collect(),
        velocities: (0..n).map(|i| at(&v, k, i)).collect(),
    };
    let s0 = state(0);
    let mut flow = Flow::<2>::from_state(&scene, &s0).unwrap();
    flow.start().unwrap();
    let d0 = flow.densities();
    println!("rho err {:e}", (0..n).map(|i| (d0[i] - rho[f * i]).abs()).fold(0.0, f64::max));
    for k in 1..f {
        flow.step().unwrap();
        let now = flow.state();
        let truth = state(k);
        let space = whirls::space::PeriodicBox { length: std::f64::consts::TAU };
        let er = (0..n)
            .map(|i| space.minimum_image(now.positions[i] - truth.positions[i]).norm())
            .fold(0.0, f64::max);
        let ev =
            (0..n).map(|i| (now.velocities[i] - truth.velocities[i]).norm()).fold(0.0, f64::max);
        println!("{k} {er:e} {ev:e}");
    }
}
