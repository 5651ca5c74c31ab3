//! Coordinates in which the force is nearly linear.
//!
//! The parameters meet in products: pressure near the reference density is
//! `c²(ρ−1) + ½(c²γ − c²)(ρ−1)² + …`, viscosity is `αc` times one thing plus `β` times another. A search
//! in `(c², αc, β, c²γ)` therefore sees an almost linear problem over one step, wherever it starts;
//! in `(c, α, β, γ)` itself it stalls where `c` is small, because `γ` has no effect there.

use crate::models::Parameter;

/// The change of coordinates for a list of learned parameters: `c → c²`, `α → αc`, `γ → c²γ` where `c`
/// is learned too, every other parameter as it is.
#[derive(Clone, Debug)]
pub struct Products {
    parameters: Vec<Parameter>,
    /// Place of `c` in the list.
    c: Option<usize>,
}

impl Products {
    /// For parameters in the order of a scene.
    pub fn new(parameters: &[Parameter]) -> Self {
        let c = parameters.iter().position(|&p| p == Parameter::C);
        Self { parameters: parameters.to_vec(), c }
    }

    /// Power of `c` that multiplies a parameter.
    fn power(&self, parameter: Parameter) -> i32 {
        match (self.c, parameter) {
            (Some(_), Parameter::Alpha) => 1,
            (Some(_), Parameter::Gamma) => 2,
            _ => 0,
        }
    }

    /// From parameters to products.
    pub fn products(&self, parameters: &[f64]) -> Vec<f64> {
        let c = self.c.map_or(1.0, |k| parameters[k]);
        let each = self.parameters.iter().zip(parameters);
        each.map(|(&p, &x)| if p == Parameter::C { c * c } else { x * c.powi(self.power(p)) })
            .collect()
    }

    /// From products to parameters; `None` where `c²` is not positive.
    pub fn parameters(&self, products: &[f64]) -> Option<Vec<f64>> {
        let square = self.c.map_or(1.0, |k| products[k]);
        if square.is_nan() || square <= 0.0 {
            return None;
        }
        let c = square.sqrt();
        let each = self.parameters.iter().zip(products);
        Some(
            each.map(|(&p, &q)| if p == Parameter::C { c } else { q / c.powi(self.power(p)) })
                .collect(),
        )
    }

    /// `∂parameters/∂products`, row by row.
    fn jacobian(&self, parameters: &[f64]) -> Vec<f64> {
        let count = parameters.len();
        let c = self.c.map_or(1.0, |k| parameters[k]);
        let mut jacobian = vec![0.0; count * count];
        for (row, (&p, &x)) in self.parameters.iter().zip(parameters).enumerate() {
            if p == Parameter::C {
                jacobian[row * count + row] = 0.5 / c;
                continue;
            }
            let power = self.power(p);
            jacobian[row * count + row] = c.powi(-power);
            if let Some(k) = self.c {
                jacobian[row * count + k] = -0.5 * f64::from(power) * x / (c * c);
            }
        }
        jacobian
    }

    /// Gradient by the products, from that by the parameters.
    pub fn pull_gradient_back(&self, parameters: &[f64], gradient: &[f64]) -> Vec<f64> {
        let n = parameters.len();
        let j = self.jacobian(parameters);
        (0..n).map(|a| (0..n).map(|k| j[k * n + a] * gradient[k]).sum()).collect()
    }

    /// Gradient and normal matrix by the products, from those by the parameters.
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

    #[test]
    fn products_and_parameters_are_inverse_and_the_jacobian_is_their_slope() {
        let products = Products::new(&Parameter::ALL);
        let x = [3.0, 0.5, -0.25, 7.0, 0.1];
        let q = products.products(&x);
        assert_eq!(q, [9.0, 1.5, -0.25, 63.0, 0.1]);
        let back = products.parameters(&q).unwrap();
        assert!(back.iter().zip(x).all(|(a, b)| (a - b).abs() < 1e-14));
        let jacobian = products.jacobian(&x);
        for column in 0..5 {
            let moved = |by: f64| {
                let mut q = q.clone();
                q[column] += by;
                products.parameters(&q).unwrap()
            };
            let (up, down) = (moved(1e-6), moved(-1e-6));
            for row in 0..5 {
                let slope = (up[row] - down[row]) / 2e-6;
                assert!((slope - jacobian[row * 5 + column]).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn without_c_the_parameters_are_their_own_products() {
        let products = Products::new(&[Parameter::Gamma, Parameter::Alpha]);
        assert_eq!(products.products(&[7.0, 2.0]), [7.0, 2.0]);
        assert_eq!(products.jacobian(&[7.0, 2.0]), [1.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn a_sound_speed_squared_that_is_not_positive_has_no_parameters() {
        assert!(Products::new(&[Parameter::C]).parameters(&[-1.0]).is_none());
    }
}
