//! What keeps turbulence going.

use super::complex::{Complex, ComplexF64x8};
use super::layout::Layout;
use super::modes::{Modes, slots_of};
use crate::forcing::ornstein_uhlenbeck::{OrnsteinUhlenbeck, Settings};
use crate::scalar::SimdFloat;
use crate::space::Space;

/// A force without divergence and without a mean; it leaves the mean velocity alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Forcing {
    /// None: decay (default).
    #[default]
    None,
    /// `f = A u` with a rate `A` (Lundgren 2003; Rosales & Meneveau 2005, doi:10.1063/1.2047568): the power is
    /// `2AE`, and the integral length comes to about `0.19 L` whatever the start.
    Linear {
        /// `A`.
        rate: f64,
    },
    /// `f = θ u/⟨|u|²⟩`: injects exactly `θ`; counterpart of the energy injection of the particles.
    LinearPower {
        /// `θ`, per unit mass.
        power: f64,
    },
    /// `f(n) = θ û(n)/Σ |û|²` over `0 < |n| <= band` (2.5 is usual): injects exactly `θ` into the large eddies.
    Band {
        /// `θ`, per unit mass.
        power: f64,
        /// The longest wave vector, in units of `2π/L`.
        band: f64,
    },
    /// Amplitudes of long waves that wander (Eswaran & Pope 1988), see [`crate::forcing::ornstein_uhlenbeck`].
    /// They are drawn every `interval` and linear in between, so that the force is a function of time alone, whatever
    /// the time step and the mesh; the variance is smaller by the share `interval/(3T)`.
    OrnsteinUhlenbeck {
        /// Strength, memory and band.
        settings: Settings,
        /// Time from one draw to the next; a twentieth of the correlation time is short enough.
        interval: f64,
        /// The seed.
        seed: u64,
    },
}

/// A forcing as it stands at one time: `f = rate û` in a band, and waves.
#[derive(Debug)]
pub(super) struct Force {
    forcing: Forcing,
    rate: f64,
    /// `|n|²` up to which `rate` acts.
    limit: f64,
    waves: Option<Stochastic>,
    sums: Vec<f64>,
}

/// The stochastic waves and where they go.
#[derive(Debug)]
struct Stochastic {
    process: OrnsteinUhlenbeck,
    interval: f64,
    /// The interval of `ends`, or none yet.
    number: Option<u64>,
    /// Amplitudes of cosine and sine at the beginning and at the end of the interval.
    ends: [Vec<[[f64; 3]; 2]>; 2],
    places: Vec<Place>,
}

/// One coefficient that a wave adds to.
#[derive(Clone, Copy, Debug)]
struct Place {
    line: usize,
    outer: usize,
    lane: usize,
    wave: usize,
    sign: f64,
    value: [[f64; 2]; 3],
}

impl Force {
    pub(super) fn new<const D: usize>(forcing: Forcing, layout: &Layout<D>) -> Self {
        let waves = match forcing {
            Forcing::OrnsteinUhlenbeck { settings, interval, seed } => {
                let process =
                    OrnsteinUhlenbeck::new(settings, D, Space::cube(layout.length), interval, seed);
                Some(Stochastic::new(process, interval, layout))
            }
            _ => None,
        };
        Self { forcing, rate: 0.0, limit: 0.0, waves, sums: vec![0.0; layout.lines()] }
    }

    /// Takes the state that it depends on: field and time.
    pub(super) fn prepare<const D: usize>(&mut self, modes: &Modes<D>, time: f64) {
        let band = match self.forcing {
            Forcing::Band { band, .. } => band,
            _ => f64::INFINITY,
        };
        self.limit = band * band;
        self.rate = match self.forcing {
            Forcing::Linear { rate } => rate,
            Forcing::LinearPower { power } | Forcing::Band { power, .. } => {
                let square = modes.square_within(band, &mut self.sums);
                if square > 0.0 { power / square } else { 0.0 }
            }
            _ => 0.0,
        };
        if let Some(waves) = &mut self.waves {
            waves.prepare(time);
        }
    }

    /// Adds the force on a line to its rate.
    #[inline(always)]
    pub(super) fn add<V: SimdFloat, const D: usize>(
        &self,
        layout: &Layout<D>,
        line: usize,
        modes: &[ComplexF64x8],
        rate: &mut [ComplexF64x8],
    ) {
        if self.rate != 0.0 {
            self.add_linear::<V, D>(layout, line, modes, rate);
        }
        if let Some(waves) = &self.waves {
            let first = waves.places.partition_point(|place| place.line < line);
            for place in waves.places[first..].iter().take_while(|place| place.line == line) {
                for axis in 0..D {
                    let eight = &mut rate[axis * layout.along + place.outer];
                    let [re, im] = eight.lane(place.lane);
                    let [more_re, more_im] = place.value[axis];
                    eight.set_lane(place.lane, [re + more_re, im + more_im]);
                }
            }
        }
    }

    #[inline(always)]
    fn add_linear<V: SimdFloat, const D: usize>(
        &self,
        layout: &Layout<D>,
        line: usize,
        modes: &[ComplexF64x8],
        rate: &mut [ComplexF64x8],
    ) {
        let (block, middle) = layout.of_line(line);
        let x = V::load(&layout.along_x(block));
        let (zero, factor) = (V::of(0.0), V::of(self.rate));
        for outer in 0..layout.along {
            let last = f64::from(layout.number(outer));
            let square = x * x + (middle * middle + last * last);
            let moving = V::select_less(zero, square, factor, zero);
            let factor = V::select_less(V::of(self.limit), square, zero, moving);
            for at in (0..D).map(|axis| axis * layout.along + outer) {
                let force = Complex::<V>::load(&modes[at]).scaled(factor);
                rate[at] = Complex::load(&rate[at]).plus(force).store();
            }
        }
    }
}

impl Stochastic {
    fn new<const D: usize>(
        mut process: OrnsteinUhlenbeck,
        interval: f64,
        layout: &Layout<D>,
    ) -> Self {
        let list = process.modes_at(0).list().to_vec();
        let mut places = Vec::new();
        for (wave, shape) in list.iter().enumerate() {
            for (slot, sign) in slots_of(layout, shape) {
                let (line, outer, lane) = (slot.line, slot.outer, slot.lane);
                places.push(Place { line, outer, lane, wave, sign, value: [[0.0; 2]; 3] });
            }
        }
        places.sort_by_key(|place| (place.line, place.outer, place.lane));
        let rest = vec![[[0.0; 3]; 2]; list.len()];
        Self { process, interval, number: None, ends: [rest.clone(), rest], places }
    }

    fn prepare(&mut self, time: f64) {
        let steps = (time / self.interval).max(0.0);
        let number = steps as u64;
        if self.number != Some(number) {
            for (end, step) in self.ends.iter_mut().zip([number, number + 1]) {
                let waves = self.process.modes_at(step).list();
                for (end, wave) in end.iter_mut().zip(waves) {
                    *end = [wave.cosine, wave.sine];
                }
            }
            self.number = Some(number);
        }
        let share = steps - number as f64;
        let [start, end] = &self.ends;
        for place in &mut self.places {
            let (a, b) = (start[place.wave], end[place.wave]);
            let at = |part: usize, axis: usize| {
                0.5 * (a[part][axis] + share * (b[part][axis] - a[part][axis]))
            };
            place.value = std::array::from_fn(|axis| [at(0, axis), -place.sign * at(1, axis)]);
        }
    }
}
