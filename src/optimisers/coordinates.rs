//! Coordinates in which the force is nearly linear, and the domains of a search.
//!
//! Each parameter defines its coordinate ([`crate::parameters::Coordinate`]): `c²` for the sound
//! speed, `αc` for the linear viscosity, `c²γ` for the exponent. In these coordinates the problem
//! is almost linear over one step from any start; in `(c, α, β, γ)` a search stalls where `c` is
//! small, because `γ` has no effect there.

use crate::parameters::{Coordinate, Domain, ParameterSpec};

/// The change of coordinates for a list of learned parameters.
#[derive(Clone, Debug)]
pub struct Coordinates {
    kinds: Vec<Kind>,
    domains: Vec<Domain>,
}

/// The coordinate of one parameter among those that are learned.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Itself,
    Square,
    /// Times a power of the parameter at this place, which is searched by its square.
    Times(usize, i32),
}

impl Coordinates {
    /// For the learned parameters, in their order.
    pub fn new(specs: &[ParameterSpec]) -> Self {
        let kind = |spec: &ParameterSpec| match &spec.coordinate {
            Coordinate::Itself => Kind::Itself,
            Coordinate::Square => Kind::Square,
            Coordinate::Times(base, power) => {
                let is_base = |other: &ParameterSpec| {
                    other.name == *base && other.coordinate == Coordinate::Square
                };
                let base = specs.iter().position(is_base);
                base.map_or(Kind::Itself, |base| Kind::Times(base, *power))
            }
        };
        let domains = specs.iter().map(|spec| spec.domain).collect();
        Self { kinds: specs.iter().map(kind).collect(), domains }
    }

    /// From parameters to coordinates.
    pub fn coordinates(&self, parameters: &[f64]) -> Vec<f64> {
        let each = self.kinds.iter().zip(parameters);
        each.map(|(kind, &x)| match *kind {
            Kind::Itself => x,
            Kind::Square => x * x,
            Kind::Times(base, power) => x * parameters[base].powi(power),
        })
        .collect()
    }

    /// From coordinates to parameters; `None` where the square of one is not positive.
    pub fn parameters(&self, coordinates: &[f64]) -> Option<Vec<f64>> {
        let root = |place: usize| {
            let square: f64 = coordinates[place];
            (square > 0.0).then(|| square.sqrt())
        };
        let parameter = |(place, kind): (usize, &Kind)| match *kind {
            Kind::Itself => Some(coordinates[place]),
            Kind::Square => root(place),
            Kind::Times(base, power) => Some(coordinates[place] / root(base)?.powi(power)),
        };
        self.kinds.iter().enumerate().map(parameter).collect()
    }

    /// Parameters on the way from `here` to `there`, each clamped to its domain.
    pub fn into_domain(&self, here: &[f64], there: &[f64]) -> Vec<f64> {
        let each = self.domains.iter().zip(here).zip(there);
        each.map(|((domain, &here), &there)| domain.clamp(here, there)).collect()
    }

    /// Which parameters are at the edge of their domain while the loss decreases beyond it: a step
    /// leaves these unchanged.
    pub fn held(&self, parameters: &[f64], gradient: &[f64]) -> Vec<bool> {
        let held = |((domain, &x), &slope): ((&Domain, &f64), &f64)| match *domain {
            Domain::NonNegative => x <= 0.0 && slope > 0.0,
            Domain::Between(least, most) => {
                (x <= least && slope > 0.0) || (x >= most && slope < 0.0)
            }
            Domain::Real | Domain::Positive => false,
        };
        self.domains.iter().zip(parameters).zip(gradient).map(held).collect()
    }

    /// `∂parameters/∂coordinates`, row by row.
    pub(crate) fn jacobian(&self, parameters: &[f64]) -> Vec<f64> {
        let count = parameters.len();
        let mut jacobian = vec![0.0; count * count];
        for (row, (kind, &x)) in self.kinds.iter().zip(parameters).enumerate() {
            let own = &mut jacobian[row * count..(row + 1) * count];
            match *kind {
                Kind::Itself => own[row] = 1.0,
                Kind::Square => own[row] = 0.5 / x,
                Kind::Times(base, power) => {
                    let c = parameters[base];
                    own[row] = c.powi(-power);
                    own[base] = -0.5 * f64::from(power) * x / (c * c);
                }
            }
        }
        jacobian
    }

    /// Gradient by the coordinates, from that by the parameters.
    pub fn pull_gradient_back(&self, parameters: &[f64], gradient: &[f64]) -> Vec<f64> {
        let n = parameters.len();
        let j = self.jacobian(parameters);
        (0..n).map(|a| (0..n).map(|k| j[k * n + a] * gradient[k]).sum()).collect()
    }

    /// Gradient and normal matrix by the coordinates, from those by the parameters.
    pub fn pull_back(
        &self,
        parameters: &[f64],
        gradient: &[f64],
        normal: &[f64],
    ) -> (Vec<f64>, Vec<f64>) {
        let n = parameters.len();
        let j = self.jacobian(parameters);
        let inner = |index: usize| -> f64 {
            let (k, b) = (index / n, index % n);
            (0..n).map(|l| normal[k * n + l] * j[l * n + b]).sum()
        };
        let inner: Vec<f64> = (0..n * n).map(inner).collect();
        let entry = |index: usize| -> f64 {
            let (a, b) = (index / n, index % n);
            (0..n).map(|k| j[k * n + a] * inner[k * n + b]).sum()
        };
        let matrix = (0..n * n).map(entry).collect();
        (self.pull_gradient_back(parameters, gradient), matrix)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::models::FluidConstants;

    fn fluid() -> Vec<ParameterSpec> {
        let constants = FluidConstants { c: 3.0, alpha: 0.5, beta: -0.25, gamma: 7.0, p0: 0.1 };
        constants.specs().to_vec()
    }

    #[test]
    fn coordinates_and_parameters_are_inverse_and_the_jacobian_is_their_slope() {
        let coordinates = Coordinates::new(&fluid());
        let x = [3.0, 0.5, -0.25, 7.0, 0.1];
        let q = coordinates.coordinates(&x);
        assert_eq!(q, [9.0, 1.5, -0.25, 63.0, 0.1]);
        let back = coordinates.parameters(&q).unwrap();
        assert!(back.iter().zip(x).all(|(a, b)| (a - b).abs() < 1e-14));
        let jacobian = coordinates.jacobian(&x);
        for column in 0..5 {
            let moved = |by: f64| {
                let mut q = q.clone();
                q[column] += by;
                coordinates.parameters(&q).unwrap()
            };
            let (up, down) = (moved(1e-6), moved(-1e-6));
            for row in 0..5 {
                let slope = (up[row] - down[row]) / 2e-6;
                assert!((slope - jacobian[row * 5 + column]).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn without_c_the_parameters_are_their_own_coordinates() {
        let specs = fluid();
        let coordinates = Coordinates::new(&[specs[3].clone(), specs[1].clone()]);
        assert_eq!(coordinates.coordinates(&[7.0, 2.0]), [7.0, 2.0]);
        assert_eq!(coordinates.jacobian(&[7.0, 2.0]), [1.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn a_sound_speed_squared_that_is_not_positive_has_no_parameters() {
        assert!(Coordinates::new(&fluid()[..1]).parameters(&[-1.0]).is_none());
        assert!(Coordinates::new(&fluid()[..1]).parameters(&[f64::NAN]).is_none());
    }

    #[test]
    fn a_positive_parameter_is_not_searched_into_the_negative() {
        let coordinates = Coordinates::new(&fluid());
        let here = [3.0, 0.5, 0.25, 7.0, 0.1];
        let there = coordinates.into_domain(&here, &[-1.0, -0.5, -0.1, -3.0, -2.0]);
        assert_eq!(there, [1.5, 0.0, 0.0, 3.5, -2.0]);
        let held = coordinates.held(&there, &[1.0, 1.0, -1.0, 1.0, 1.0]);
        assert_eq!(held, [false, true, false, false, false]);
    }
}
