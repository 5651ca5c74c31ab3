//! Resolution, kernel, sound and viscosity.

use super::{Item, Size, Sound, Start, Viscous, Wish};
use crate::error::{Error, Result};
use crate::viscosity::effective_nu;
use std::f64::consts::TAU;

/// Number of neighbours above which the cubic spline lets particles pair up (README, Choosing).
const MANY: f64 = 40.0;

const CHOOSING: &str = "README, Choosing";

/// The numbers of a scene that a wish determines.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Numbers {
    /// Particles along each axis.
    pub(super) side: usize,
    /// `h/Δx`.
    pub(super) ratio: f64,
    /// Name of the kernel.
    pub(super) kernel: &'static str,
    /// Sound speed.
    pub(super) c: f64,
    /// Laminar viscosity; none where `α` is asked for.
    pub(super) nu: Option<f64>,
    /// Monaghan's `α`.
    pub(super) alpha: f64,
    /// Power of the forcing; none for a decaying flow.
    pub(super) power: Option<f64>,
    /// Duration.
    pub(super) duration: f64,
}

impl Numbers {
    /// Particle spacing.
    pub(super) fn spacing(&self, wish: &Wish) -> f64 {
        wish.box_length / self.side as f64
    }

    /// The viscosity that acts.
    pub(super) fn acting_nu(&self, wish: &Wish) -> f64 {
        let h = self.ratio * self.spacing(wish);
        self.nu.unwrap_or(0.0) + effective_nu(wish.dimension, self.ratio, self.alpha * self.c * h)
    }
}

impl Wish {
    /// The length of the Reynolds number.
    pub(super) fn scale(&self) -> f64 {
        self.length.unwrap_or(self.box_length / TAU)
    }

    /// The eddy time `L/(2πU)`.
    pub(super) fn eddy_time(&self) -> f64 {
        self.box_length / (TAU * self.speed)
    }
}

/// Neighbours within the support `2h`.
fn neighbours(dimension: usize, ratio: f64) -> f64 {
    let radius = 2.0 * ratio;
    match dimension {
        2 => std::f64::consts::PI * radius * radius,
        _ => 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3),
    }
}

/// The numbers of a wish, and the advice on them.
pub(super) fn choose(wish: &Wish) -> Result<(Numbers, Vec<Item>)> {
    let (ratio, width) = width(wish);
    let (side, resolution) = resolution(wish, ratio)?;
    let (c, sound) = sound(wish);
    let (kernel, kind) = kernel(wish, ratio);
    let (nu, alpha) = match wish.viscosity {
        Viscous::Reynolds(re) => (Some(wish.speed * wish.scale() / re), 0.0),
        Viscous::Nu(nu) => (Some(nu), 0.0),
        Viscous::Alpha(alpha) => (None, alpha),
    };
    let power = (wish.flow == Start::Stirred).then(|| {
        // ε = ½ u'³/L_int, L_int = 0.19 L.
        0.5 * wish.speed.powi(3) / (0.19 * wish.box_length)
    });
    let duration = wish.duration.unwrap_or(5.0 * wish.eddy_time());
    let numbers = Numbers { side, ratio, kernel, c, nu, alpha, power, duration };
    let viscous = viscous(wish, &numbers);
    let forcing = numbers.power.map(forcing);
    let items = [resolution, width, kind, sound, viscous].into_iter().chain(forcing);
    Ok((numbers, items.collect()))
}

fn width(wish: &Wish) -> (f64, Item) {
    let known = !matches!(wish.viscosity, Viscous::Alpha(_));
    let table = "README, Against a known solution";
    let (ratio, reason, source) = match (wish.h_over_spacing, known, wish.dimension) {
        (Some(given), ..) => (given, "asked for", "your --h-over-spacing"),
        (None, true, 2) => (
            2.0,
            "a viscosity that is known: at 1.2 the measured one is 1.4 times that asked for, at 2 within 1 %",
            table,
        ),
        (None, true, _) => (
            2.0,
            "nearest to the viscosity asked for, though vortices still decay too fast; 1.2 takes a fifth of the time",
            table,
        ),
        (None, false, 2) => {
            (1.3, "enough neighbours for the density, few enough for the cubic spline", CHOOSING)
        }
        (None, false, _) => (1.05, "as many neighbours as the cubic spline carries", CHOOSING),
    };
    let count = neighbours(wish.dimension, ratio);
    let item = Item {
        name: "fluid.h_over_spacing",
        value: format!("{ratio} ({count:.0} neighbours)"),
        number: Some(ratio),
        reason: reason.to_owned(),
        source: source.to_owned(),
    };
    (ratio, item)
}

fn resolution(wish: &Wish, ratio: f64) -> Result<(usize, Item)> {
    let (side, reason) = match wish.size {
        Size::Particles(count) => {
            let side = (count as f64).powf(1.0 / wish.dimension as f64).round() as usize;
            (side, format!("{count} particles asked for"))
        }
        Size::Smallest(scale) => {
            let side = (2.0 * ratio * wish.box_length / scale).ceil();
            (side as usize, format!("the kernel's support 2h resolves the length {scale}"))
        }
    };
    // The support must be at most half the box.
    let least = (4.0 * ratio).ceil() as usize + 1;
    if side < least {
        return Err(Error::input(
            "--particles or --smallest",
            format!(
                "at least {least} particles along each axis, so that the support 2h is less than half the box"
            ),
            side,
            "ask for more particles, a smaller length, or a smaller --h-over-spacing",
        ));
    }
    let count = side.saturating_pow(wish.dimension as u32);
    let item = Item {
        name: "fluid.particles_per_side",
        value: format!("{side} ({count} particles, spacing {:.4})", wish.box_length / side as f64),
        number: Some(side as f64),
        reason,
        source: "the box and your size".to_owned(),
    };
    Ok((side, item))
}

fn kernel(wish: &Wish, ratio: f64) -> (&'static str, Item) {
    let count = neighbours(wish.dimension, ratio);
    let known = !matches!(wish.viscosity, Viscous::Alpha(_));
    let (name, reason, source) = match (count > MANY, known) {
        (true, true) => (
            "cubic-spline",
            "the measured viscosities are of this kernel (wendland-c2 is 1.5 times as viscous at this width); with so \
             many neighbours an eighth of its particles pair up",
            "README, Against a known solution; Where it holds",
        ),
        (true, false) => (
            "wendland-c2",
            "at so many neighbours particles pair up with a cubic spline, with Wendland's kernels they do not",
            "Dehnen & Aly 2012, doi:10.1111/j.1365-2966.2012.21439.x",
        ),
        (false, _) => ("cubic-spline", "the least biased density at few neighbours", CHOOSING),
    };
    let item = Item {
        name: "fluid.kernel",
        value: name.to_owned(),
        number: None,
        reason: reason.to_owned(),
        source: source.to_owned(),
    };
    (name, item)
}

fn sound(wish: &Wish) -> (f64, Item) {
    let (c, reason) = match wish.sound {
        Sound::Mach(mach) => {
            (wish.speed / mach, format!("Mach number U/c = {mach}: densities vary by some Mach²"))
        }
        Sound::Speed(c) => (c, format!("asked for: Mach number U/c = {:.3}", wish.speed / c)),
    };
    let item = Item {
        name: "fluid.c",
        value: format!("{c:.4} (density within some {:.1e})", (wish.speed / c).powi(2)),
        number: Some(c),
        reason,
        source: "Monaghan 1994, doi:10.1006/jcph.1994.1034".to_owned(),
    };
    (c, item)
}

fn viscous(wish: &Wish, numbers: &Numbers) -> Item {
    let reynolds = |nu: f64| wish.speed * wish.scale() / nu;
    match numbers.nu {
        Some(nu) => Item {
            name: "fluid.viscosity.nu",
            value: format!("{nu:.4e}, kind morris, alpha 0 (Reynolds number {:.1})", reynolds(nu)),
            number: Some(nu),
            reason: format!("ν = U ℓ/Re with U = {} and ℓ = {:.4}", wish.speed, wish.scale()),
            source: "Morris, Fox & Zhu 1997, doi:10.1006/jcph.1997.5776; README, Against a known solution"
                .to_owned(),
        },
        None => {
            let acting = numbers.acting_nu(wish);
            Item {
                name: "fluid.alpha",
                value: format!("{} (acts as nu {acting:.2e}, Reynolds number {:.1})", numbers.alpha, reynolds(acting)),
                number: Some(numbers.alpha),
                reason: "Monaghan's viscosity, which grows with c and h: give --reynolds or --nu for a known one"
                    .to_owned(),
                source: "measured table of whirls::viscosity::effective_nu".to_owned(),
            }
        }
    }
}

fn forcing(power: f64) -> Item {
    Item {
        name: "forcing.theta",
        value: format!("{power:.4}, kind deterministic, power exact"),
        number: Some(power),
        reason: "the dissipation ½ U³/L_int of eddies of L_int = 0.19 L keeps U, at high Reynolds number".to_owned(),
        source: "Rosales & Meneveau 2005, doi:10.1063/1.2047568".to_owned(),
    }
}
