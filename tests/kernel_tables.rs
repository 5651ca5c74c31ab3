//! Kernels with a learnable shape: normalisation, table against formula, derivatives by the
//! parameters, and their notation in scenes.

use crate::common;

use common::in_2d_and_3d;
use whirls::kernel::{
    Kernel, KernelChoice, KernelTable, LearnableKernel, LearnableShape, SHAPES, Smoothing, W2, WAb,
    normalisation,
};
use whirls::scalar::{
    Dual, F64x8, Precision, Scalar, SimdFloat, SimdTask, WIDTH, on_every_instruction_set,
};
use whirls::{Error, Scene};

in_2d_and_3d!(
    the_normalisation_is_the_closed_form,
    a_table_integrates_to_one,
    a_table_is_its_formula,
    derivatives_by_the_parameters_are_those_of_whole_tables,
    every_instruction_set_gives_the_same_bits,
);

const AB: [[f64; 2]; 6] =
    [[2.932, 3.559], [2.0, 2.0], [2.2, 5.0], [3.5, 2.5], [4.0, 8.0], [10.0, 10.0]];
const TWO: [[f64; 2]; 5] = [[0.2, -0.9], [0.1, -1.0], [0.15, 2.0], [1.0, 0.5], [10.0, 0.0]];

/// `ln Γ(x)` by Lanczos' approximation of nine terms, to 1e-15.
fn ln_gamma(x: f64) -> f64 {
    const TERMS: [f64; 9] = [
        0.999_999_999_999_809_9,
        676.520_368_121_885_1,
        -1_259.139_216_722_402_8,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507_343_278_686_905,
        -0.138_571_095_265_720_12,
        9.984_369_578_019_572e-6,
        1.505_632_735_149_311_6e-7,
    ];
    let x = x - 1.0;
    let term = |(k, c): (usize, &f64)| if k == 0 { *c } else { c / (x + k as f64) };
    let series: f64 = TERMS.iter().enumerate().map(term).sum();
    let t = x + 7.5;
    0.5 * (2.0 * std::f64::consts::PI).ln() + (x + 0.5) * t.ln() - t + series.ln()
}

fn the_normalisation_is_the_closed_form<const D: usize>() {
    assert!((ln_gamma(5.0) - 24.0_f64.ln()).abs() < 1e-14);
    for [a, b] in AB {
        let e = D as f64 / a;
        let gammas = (ln_gamma(b + e + 1.0) - ln_gamma(b + 1.0) - ln_gamma(e + 1.0)).exp();
        let pi = std::f64::consts::PI;
        let exact = gammas * if D == 2 { 1.0 / (4.0 * pi) } else { 3.0 / (32.0 * pi) };
        let apart = normalisation::<WAb, f64>(&[a, b], D) / exact - 1.0;
        assert!(apart.abs() < 1e-10, "{a}, {b}: {apart:e}");
    }
}

/// Every shape with the parameters to try.
fn every_table(dimension: usize) -> impl Iterator<Item = KernelTable> {
    let ab = AB.into_iter().map(move |at| KernelTable::of::<WAb>(at, dimension));
    ab.chain(TWO.into_iter().map(move |at| KernelTable::of::<W2>(at, dimension)))
}

fn a_table_integrates_to_one<const D: usize>() {
    for table in every_table(D) {
        // The error of the midpoint rule in q is (1/20000)² times the integrand's slopes at the
        // ends, which are zero.
        let n = 20_000;
        let step = 2.0 / f64::from(n);
        let ring = |k: i32| {
            let q = (f64::from(k) + 0.5) * step;
            let surface = if D == 2 { 2.0 * q } else { 4.0 * q * q };
            std::f64::consts::PI * surface * table.value(q) * step
        };
        let one: f64 = (0..n).map(ring).sum();
        assert!((one - 1.0).abs() < 1e-8, "{table:?}: {:e}", one - 1.0);
    }
}

/// Largest differences between table and formula at places between all knots: of the value, over that at
/// the centre; of `W'`, over its largest; and of both from `r = 0.3 h` on.
fn errors<S: LearnableShape>(at: [f64; 2], dimension: usize) -> [f64; 4] {
    let table = KernelTable::of::<S>(at, dimension);
    let scale = normalisation::<S, f64>(&at, dimension);
    let formula = |q: f64| scale * S::shape(0.5 * q, &at);
    let (mut apart, mut largest) = ([0.0_f64; 4], 0.0_f64);
    for k in 0..9999 {
        let q = 2e-4 * f64::from(k);
        // Exact with dual numbers, except that a power has no such derivative at zero.
        let slope = if k == 0 {
            0.0
        } else {
            let parameters = at.map(Dual::<f64, 1>::of);
            scale * S::shape(Dual::variable(q, 0, [0.0]) * 0.5, &parameters).gradient[0]
        };
        let here = [table.value(q) - formula(q), table.dw_over_r(q) * q - slope].map(f64::abs);
        for (number, here) in here.into_iter().enumerate() {
            apart[number] = apart[number].max(here);
            apart[2 + number] = apart[2 + number].max(if q < 0.3 { 0.0 } else { here });
        }
        largest = largest.max(slope.abs());
    }
    let scales = [formula(0.0), largest, formula(0.0), largest];
    std::array::from_fn(|k| apart[k] / scales[k])
}

/// The largest errors are those of the first intervals, where `W_ab` with `2 < a < 4` has no fourth
/// derivative and the tip of `W₂` is as narrow as `a`.
fn a_table_is_its_formula<const D: usize>() {
    let within = |name: &str, at: [f64; 2], found: [f64; 4], bounds: [f64; 4]| {
        assert!((0..4).all(|k| found[k] < bounds[k]), "{name} {at:?}: {found:?}");
    };
    within("w-ab", AB[0], errors::<WAb>(AB[0], D), [1.2e-5, 4e-4, 4e-8, 3e-7]);
    for at in AB {
        within("w-ab", at, errors::<WAb>(at, D), [1e-4, 3e-3, 1e-6, 1e-4]);
    }
    within("w-2", TWO[0], errors::<W2>(TWO[0], D), [4e-8, 2e-6, 1e-9, 3e-7]);
    for at in TWO {
        within("w-2", at, errors::<W2>(at, D), [3e-6, 2e-4, 1e-7, 1e-5]);
    }
}

fn derivatives_by_the_parameters_are_those_of_whole_tables<const D: usize>() {
    const H: f64 = 0.7;
    for shape in SHAPES {
        let at = shape.parameters.map(|parameter| parameter.start);
        let of = |at: [f64; 2]| Smoothing::<KernelTable, D>::of(shape.table(at, D), H);
        let here = of(at);
        assert_eq!(here.kernel().parameters(), 2);
        for p in 0..2 {
            // Central differences of fourth order.
            let step = 1e-4;
            let around = [step, -step, 2.0 * step, -2.0 * step].map(|by| {
                let mut at = at;
                at[p] += by;
                of(at)
            });
            for k in 0..500 {
                let r = 2.02 * H * f64::from(k) / 500.0;
                let near = |exact: f64, [a, b, c, d]: [f64; 4], bound: f64| {
                    let central = (8.0 * (a - b) - (c - d)) / (12.0 * step);
                    let apart = (exact - central).abs();
                    assert!(apart < bound, "{} by {p} at {r}: {apart:e}", shape.name);
                };
                // Round-off divided by the step; that of a slope is larger by the 512 intervals.
                let bound = 1e-10 * here.value(0.0);
                near(here.value_by(p, r), around.each_ref().map(|w| w.value(r)), bound);
                let bound = 1e-8 * here.value(0.0) / (H * H);
                near(here.dw_over_r_by(p, r), around.each_ref().map(|w| w.dw_over_r(r)), bound);
            }
        }
        for beyond in [here.value_by(2, 0.3), here.dw_over_r_by(7, 0.3)] {
            assert_eq!(beyond.to_bits(), 0);
        }
    }
}

/// Everything that a table says of eight distances.
#[derive(Clone)]
struct Everything<'a, const D: usize>(&'a Smoothing<KernelTable, D>, F64x8);

impl<const D: usize> SimdTask for Everything<'_, D> {
    type Output = [[u64; WIDTH]; 7];

    #[inline(always)]
    fn run<W: SimdFloat>(self) -> Self::Output {
        let (table, r) = (self.0, W::load(&self.1));
        let [gradient, curvature] = table.dw_derivatives(r);
        let all = [table.value(r), table.dw_over_r(r), table.d_dw_over_r(r), gradient, curvature];
        let by = [table.value_by(0, r), table.dw_over_r_by(1, r)];
        let bits = |x: W| x.store().to_array().map(f64::to_bits);
        let [value, g, h, g2, h2] = all.map(bits);
        let [by_a, by_b] = by.map(bits);
        [value, g, h, g2, h2, by_a, by_b]
    }
}

fn every_instruction_set_gives_the_same_bits<const D: usize>() {
    for table in every_table(D) {
        let table = Smoothing::<KernelTable, D>::of(table, 0.3);
        for first in 0..20 {
            let r = F64x8::new(std::array::from_fn(|l| 0.004 * (8 * first + l) as f64));
            for precision in Precision::ALL {
                let found = on_every_instruction_set(precision, &Everything(&table, r));
                for (name, bits) in &found {
                    assert_eq!(*bits, found[0].1, "{name} in {precision:?} at {r:?}");
                }
            }
        }
    }
}

fn opened(spelling: &str) -> Result<KernelChoice, Error> {
    let set = [format!("fluid.kernel={spelling}")];
    Scene::open("inverse-3d", &set).map(|scene| scene.fluid.kernel)
}

#[test]
fn a_scene_spells_a_kernel_as_a_name_or_as_a_table() {
    let learnable = |name: &str, parameters, positive| {
        let shape = SHAPES.iter().find(|shape| shape.name == name).unwrap();
        KernelChoice::Learnable(LearnableKernel { shape, parameters, positive })
    };
    let cases = [
        ("wendland-c2", KernelChoice::WendlandC2),
        ("{kind='wendland-c4'}", KernelChoice::WendlandC4),
        ("w-ab", learnable("w-ab", [2.932, 3.559], false)),
        ("w-2", learnable("w-2", [0.2, -0.9], false)),
        ("{kind='w-ab'}", learnable("w-ab", [2.932, 3.559], false)),
        ("{b=4,kind='w-ab'}", learnable("w-ab", [2.932, 4.0], false)),
        ("{kind='w-2',a=0.15,b=-0.95,positive=true}", learnable("w-2", [0.15, -0.95], true)),
    ];
    for (spelling, kernel) in cases {
        assert_eq!(opened(spelling).unwrap(), kernel, "{spelling}");
    }
}

#[test]
fn a_scene_with_any_kernel_is_read_back_equal() {
    for spelling in ["cubic-spline", "wendland-c4", "w-ab", "{kind='w-2',a=0.15,positive=true}"] {
        let set = [format!("fluid.kernel={spelling}")];
        let scene = Scene::open("inverse-2d", &set).unwrap();
        let text = scene.to_toml();
        assert_eq!(Scene::parse(&text, "again", &[]).unwrap(), scene, "{text}");
        let json = serde_json::to_string(&scene).unwrap();
        assert_eq!(serde_json::from_str::<Scene>(&json).unwrap(), scene, "{json}");
    }
    let text = Scene::open("inverse-2d", &["fluid.kernel=wendland-c4".to_owned()]).unwrap();
    assert!(text.to_toml().contains("kernel = \"wendland-c4\"\n"));
}

#[test]
fn kernels_that_no_run_could_use_are_refused_with_what_was_expected() {
    let cases: &[(&str, &[&str])] = &[
        ("w-3", &["w-3", "cubic-spline", "wendland-c4", "w-ab", "w-2"]),
        ("{a=2.9}", &["kind"]),
        ("{kind='w-3'}", &["w-3", "w-ab", "w-2"]),
        ("{kind='w-ab',c=1.0}", &["`c`", "w-ab", "a, b", "positive"]),
        ("{kind='cubic-spline',a=1.0}", &["`a`", "cubic-spline", "kind alone"]),
        ("{kind='cubic-spline',positive=true}", &["`positive`", "cubic-spline"]),
        ("{kind='w-ab',a='two'}", &["two"]),
        ("{kind='w-ab',a=1.9}", &["fluid.kernel.a", "from 2 to 10", "1.9"]),
        ("{kind='w-ab',b=nan}", &["fluid.kernel.b", "from 2 to 10", "NaN"]),
        ("{kind='w-2',b=inf}", &["fluid.kernel.b", "from -1 to 2", "inf"]),
        ("{kind='w-ab',positive=true}", &["fluid.kernel", "-1e-4", "-2.9e-2 at kh = 4.39"]),
        ("7", &["kernel", "w-ab"]),
    ];
    for (spelling, words) in cases {
        let message = opened(spelling).unwrap_err().to_string();
        for word in *words {
            assert!(message.contains(word), "{spelling}: no {word} in {message}");
        }
    }
}
