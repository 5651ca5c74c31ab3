//! The cost of a step: density and forces compared with the pure arithmetic and with a plain loop,
//! the neighbour search, the whole step; by number of particles, neighbours, precision.

#![allow(clippy::unwrap_used, reason = "a benchmark may stop here")]
#![allow(clippy::print_stdout, reason = "a benchmark prints what it measured")]

mod common;

use bevy_ecs::prelude::*;
use bevy_ecs::system::RunSystemOnce;
use clap::Parser;
use common::{Flows, Run, Took, in_turn, median};
use std::hint::black_box;
use std::time::{Duration, Instant};
use whirls::models::Medium;
use whirls::pairs::Pair;
use whirls::scalar::{
    F64x8, Precision, Scalar, SimdFloat, SimdTask, WIDTH, dispatch_in, on_every_instruction_set,
};
use whirls::space::Space;
use whirls::systems::Phase;
use whirls::systems::acceleration::accelerate;
use whirls::systems::density::sum_density;
use whirls::systems::neighbours::{Neighbours, find_neighbours};
use whirls::systems::packing::pack_velocities;
use whirls::systems::particles::PairInputs;
use whirls::vector::Vector;
use whirls::{Flow, Scene};

/// Measures what a step costs, and prints it.
#[derive(Clone, Debug, Parser)]
struct Arguments {
    #[command(flatten)]
    flows: Flows,
    /// Skin of the neighbour lists in smoothing lengths [default: the scenes'].
    #[arg(long)]
    skin: Option<f64>,
}

fn main() {
    let arguments = Flows::read(|arguments: &mut Arguments| &mut arguments.flows);
    println!(
        "3D, kick-drift-kick, {} threads, medians of {} rounds; nanoseconds\n",
        arguments.flows.threads, arguments.flows.rounds
    );
    print_floors(arguments.flows.rounds);
    println!(
        "{:>8} {:>10} {:>9} | {:>8} {:>7} {:>7} {:>8} {:>7} | {:>8} {:>7} {:>7} | {:>6} {:>6} {:>6} {:>6} {:>8}",
        "N",
        "neighbours",
        "precision",
        "evaluate",
        "/pair",
        "floor",
        "/floor",
        "plain",
        "step",
        "/pair",
        "/floor",
        "search",
        "build",
        "pack",
        "builds",
        "bytes/N",
    );
    for size in arguments.flows.all() {
        for precision in Precision::ALL {
            Contestant::new(&arguments, size, precision).print(&arguments);
        }
    }
    println!(
        "\nevaluate: density and forces of all particles, lists given, per particle; /pair: per directed \
         pair within 2h\nfloor: the same formulas on operands in registers, per pair; plain: evaluate of a \
         loop over single doubles, over ours\nsearch: share of the steps that finds neighbours and packs, timed within them; build: a search that builds lists anew, per \
         particle; pack: one that does not; builds: of lists, a step"
    );
}

/// Time of the pure arithmetic with every instruction set, in nanoseconds per pair.
#[derive(Clone)]
struct TimedFloor<'a> {
    medium: &'a Medium<3>,
    rounds: usize,
}

impl SimdTask for TimedFloor<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<W: SimdFloat>(self) -> f64 {
        let clock = Instant::now();
        black_box(Floor { medium: self.medium, rounds: self.rounds }.run::<W>());
        1e9 * clock.elapsed().as_secs_f64() / (self.rounds * WIDTH) as f64
    }
}

/// The lower bound of each instruction set and precision: the possible gain of mixed precision.
fn print_floors(rounds: usize) {
    let scene = Scene::open("inverse-3d", &[]).unwrap();
    let medium = &Medium::<3>::of(&scene, scene.particles());
    println!("floor by instruction set, per pair");
    for precision in Precision::ALL {
        let pass = TimedFloor { medium, rounds: 100_000 };
        let all: Vec<_> = (0..rounds).map(|_| on_every_instruction_set(precision, &pass)).collect();
        let sets = (0..all[0].len()).map(|set| {
            let took = median(all.iter().map(|round| round[set].1));
            format!("{} {took:.2}", all[0][set].0)
        });
        println!("  {:9} {}", precision.name(), sets.collect::<Vec<_>>().join(", "));
    }
    println!();
}

/// The time of neighbour searches within steps.
#[derive(Resource)]
struct Search {
    began: Instant,
    took: Duration,
}

fn begin_search(mut search: ResMut<Search>) {
    search.began = Instant::now();
}

fn end_search(mut search: ResMut<Search>) {
    let took = search.began.elapsed();
    search.took += took;
}

/// A developed flow of some size.
struct Contestant {
    scene: Scene,
    flow: Flow<3>,
    particles: usize,
    neighbours: f64,
}

/// Steps that are timed together: several times the number for which lists are valid, because the
/// first of them uses lists that were just built.
fn steps_of(particles: usize) -> u64 {
    (400_000 / particles).clamp(12, 40) as u64
}

impl Contestant {
    fn new(arguments: &Arguments, (side, width): (usize, f64), precision: Precision) -> Self {
        let mut scene = Scene::open("inverse-3d", &[]).unwrap();
        scene.fluid.particles_per_side = side;
        scene.fluid.smoothing_length = width * scene.fluid.box_length / side as f64;
        scene.time.step = whirls::systems::verlet::Step::KickDriftKick;
        scene.time.skin = arguments.skin.unwrap_or(scene.usual_skin());
        scene.precision = precision;
        let mut flow = Flow::<3>::new(&scene).unwrap();
        flow.world_mut().insert_resource(Search { began: Instant::now(), took: Duration::ZERO });
        flow.schedule_mut()
            .add_systems(begin_search.after(Phase::Drift).before(Phase::Neighbours))
            .add_systems(end_search.after(Phase::Pack).before(Phase::Density));
        (0..20).for_each(|_| flow.step().unwrap());
        let neighbours = flow.neighbours_per_particle();
        Self { particles: scene.particles(), scene, flow, neighbours }
    }

    fn print(self, arguments: &Arguments) {
        let pairs = self.neighbours * self.particles as f64;
        let medium = Medium::<3>::of(&self.scene, self.particles);
        let steps = steps_of(self.particles);
        let bytes: f64 = self.flow.bytes_per_particle().iter().map(|(_, bytes)| bytes).sum();
        let before = self.flow.world().resource::<Neighbours<3>>().rebuilds;
        let cell = std::cell::RefCell::new(self.flow);
        let evaluate = || {
            let flow = &mut *cell.borrow_mut();
            rayon::scope(|_| {
                flow.world_mut().run_system_once(sum_density::<3>).unwrap();
                flow.world_mut().run_system_once(accelerate::<3>).unwrap();
            });
            0
        };
        let search = || {
            let flow = &mut *cell.borrow_mut();
            rayon::scope(|_| {
                flow.world_mut().run_system_once(find_neighbours::<3>).unwrap();
                flow.world_mut().run_system_once(pack_velocities::<true, true, 3>).unwrap();
            });
            0
        };
        let build = || {
            cell.borrow_mut().world_mut().resource_mut::<Neighbours<3>>().invalidate();
            search()
        };
        let plain = || {
            plain_evaluation(cell.borrow_mut().world_mut(), &medium);
            0
        };
        let shares = std::cell::RefCell::new(Vec::new());
        let step = || {
            let flow = &mut *cell.borrow_mut();
            flow.world_mut().resource_mut::<Search>().took = Duration::ZERO;
            let clock = Instant::now();
            (0..steps).for_each(|_| flow.step().unwrap());
            let took = flow.world().resource::<Search>().took;
            shares.borrow_mut().push(took.as_secs_f64() / clock.elapsed().as_secs_f64());
            0
        };
        let floor = || {
            let rounds = 200_000;
            black_box(dispatch_in(self.scene.precision, Floor { medium: &medium, rounds }));
            0
        };
        let mut runs: Vec<Run<'_>> = vec![
            Box::new(floor),
            Box::new(plain),
            Box::new(build),
            Box::new(search),
            Box::new(step),
        ];
        let took = in_turn(arguments.flows.rounds, Box::new(evaluate), &mut runs);
        drop(runs);
        let rebuilds = cell.borrow().world().resource::<Neighbours<3>>().rebuilds - before;
        let built = rebuilds as f64 - (arguments.flows.rounds + 1) as f64;
        let each = built / ((arguments.flows.rounds + 1) as f64 * steps as f64);
        let per = |took: &Took, count: f64| took.milliseconds * 1e6 / count;
        let (n, all) = (self.particles as f64, self.particles as f64 * steps as f64);
        let own = per(&took[0], pairs);
        let floor = per(&took[1], 200_000.0 * WIDTH as f64);
        let whole = per(&took[5], all);
        // The first steps allocate memory, and are not counted.
        let share = median(shares.borrow()[1..].iter().copied());
        println!(
            "{:8} {:10.1} {:>9} | {:8.1} {:7.2} {:7.2} {:7.2}x {:6.1}x | {:8.1} {:7.2} {:6.2}x | {:5.0}% {:6.1} {:6.1} {:6.2} {:8.0}",
            self.particles,
            self.neighbours,
            self.scene.precision.name(),
            per(&took[0], n),
            own,
            floor,
            own / floor,
            took[2].ratio,
            whole,
            whole / self.neighbours,
            whole / self.neighbours / floor,
            100.0 * share,
            per(&took[3], n),
            per(&took[4], n),
            each,
            bytes,
        );
    }
}

/// Density and force of pairs with operands in registers.
struct Floor<'a> {
    medium: &'a Medium<3>,
    rounds: usize,
}

impl SimdTask for Floor<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<W: SimdFloat>(self) -> f64 {
        let h = self.medium.smoothing.h;
        let space = Space::cube(20.0 * h);
        let spread = |base: f64, by: f64| {
            let mut lanes = F64x8::ZERO;
            (0..WIDTH).for_each(|l| lanes.set_lane(l, base + by * l as f64));
            W::load(&black_box(lanes))
        };
        let mut there =
            Vector([spread(0.1 * h, 0.2 * h), spread(0.2 * h, 0.1 * h), spread(-0.5 * h, 0.1 * h)]);
        let speed = Vector([spread(0.3, -0.1), spread(-0.2, 0.1), spread(0.1, 0.05)]);
        let (rho, p_over_rho2) = (spread(1.0, 0.01), spread(2.0, 0.1));
        let (here, moves, drift) = (W::of(black_box(0.0)), W::of(black_box(0.1)), W::of(1e-7 * h));
        let (mut density, mut force) = (W::Double::of(0.0), Vector::<W::Double, 3>::zero());
        for _ in 0..self.rounds {
            there[0] += drift;
            let (mut r, mut v) = (there, speed);
            for axis in 0..3 {
                r[axis] = here - there[axis];
                v[axis] = moves - speed[axis];
            }
            let r = space.minimum_image(r);
            density += self.medium.smoothing.value(r.norm_squared().sqrt()).widen();
            // Different distances, because the compiler would compute equal roots once.
            let pair =
                Pair { r2: r.norm_squared() + drift, v_dot_r: v.dot(r), rho_i: rho, rho_j: rho };
            let along = r * self.medium.strength(&pair, p_over_rho2 + p_over_rho2);
            for axis in 0..3 {
                force[axis] += along[axis].widen();
            }
        }
        density.sum() + force[0].sum() + force[1].sum() + force[2].sum()
    }
}

/// Density and forces by a plain scalar loop in `f64`, over the same lists.
fn plain_evaluation(world: &mut bevy_ecs::world::World, medium: &Medium<3>) {
    let neighbours = world.resource::<Neighbours<3>>();
    let support2 = medium.smoothing.support() * medium.smoothing.support();
    let cloud = world.resource::<PairInputs>();
    let place = |slot: usize| Vector(cloud.packed[slot].position);
    let mut sums = (Vec::with_capacity(cloud.len()), Vec::with_capacity(cloud.len()));
    for chunk in neighbours.chunks.iter() {
        for k in 0..chunk.len() {
            let here = chunk.first + k;
            let mut density = medium.smoothing.value(0.0);
            for j in chunk.slots_of(k) {
                let r2 = neighbours.space.minimum_image(place(here) - place(j)).norm_squared();
                if r2 < support2 {
                    density += medium.smoothing.value(r2.sqrt());
                }
            }
            sums.0.push(density * medium.mass);
        }
    }
    for chunk in neighbours.chunks.iter() {
        for k in 0..chunk.len() {
            let here = &cloud.packed[chunk.first + k];
            let mut force = Vector::<f64, 3>::zero();
            for j in chunk.slots_of(k) {
                let there = &cloud.packed[j];
                let r = Vector(here.position) - Vector(there.position);
                let r = neighbours.space.minimum_image(r);
                let r2 = r.norm_squared();
                if r2 < support2 {
                    let v = Vector(here.velocity) - Vector(there.velocity);
                    let (rho_i, rho_j) = (here.density, there.density);
                    let pair = Pair { r2, v_dot_r: v.dot(r), rho_i, rho_j };
                    force += r * medium.strength(&pair, here.p_over_rho2 + there.p_over_rho2);
                }
            }
            sums.1.push(force);
        }
    }
    black_box(sums);
}
