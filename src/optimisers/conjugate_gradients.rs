//! Conjugate gradients (Hestenes & Stiefel 1952), with a preconditioner: solves `A x = b` for a symmetric positive
//! definite matrix of which only products with vectors are known.

use crate::error::Result;

/// A solution by conjugate gradients.
#[derive(Clone, Debug)]
pub struct ConjugateSolution {
    /// `x`.
    pub solution: Vec<f64>,
    /// Number of products `A p`.
    pub products: usize,
    /// `|b − A x| / |b|` in the norm of the preconditioner.
    pub residual: f64,
}

/// Solves `A x = b` until the residual is `tolerance` of what it was for `x = 0`, or after `most` products.
///
/// `product` is `A p`, `precondition` an approximation of `A⁻¹ r`, also symmetric and positive definite.
///
/// # Errors
/// Those of `product`.
pub fn conjugate_gradients(
    product: &mut dyn FnMut(&[f64]) -> Result<Vec<f64>>,
    precondition: &dyn Fn(&[f64]) -> Vec<f64>,
    right: &[f64],
    (tolerance, most): (f64, usize),
) -> Result<ConjugateSolution> {
    let mut solution = vec![0.0; right.len()];
    let mut residual = right.to_vec();
    let mut near = precondition(&residual);
    let mut direction = near.clone();
    let mut size = dot(&residual, &near);
    let first = size;
    let mut products = 0;
    while products < most && size > tolerance * tolerance * first {
        let image = product(&direction)?;
        products += 1;
        let curvature = dot(&direction, &image);
        // Not reached where the matrix is positive definite and round-off small.
        if curvature <= 0.0 || !curvature.is_finite() {
            break;
        }
        let length = size / curvature;
        add(&mut solution, length, &direction);
        add(&mut residual, -length, &image);
        near = precondition(&residual);
        let new = dot(&residual, &near);
        let turn = new / size;
        direction.iter_mut().zip(&near).for_each(|(d, z)| *d = z + turn * *d);
        size = new;
    }
    let residual = if first > 0.0 { (size / first).sqrt() } else { 0.0 };
    Ok(ConjugateSolution { solution, products, residual })
}

/// `Σ a b`.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn add(sum: &mut [f64], length: f64, direction: &[f64]) {
    sum.iter_mut().zip(direction).for_each(|(sum, d)| *sum += length * d);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_with_few_different_eigenvalues_takes_as_many_products() {
        let eigen = |k: usize| [1.0, 10.0, 1000.0][k % 3];
        let right: Vec<f64> = (0..90).map(|k| 1.0 + k as f64).collect();
        let mut product = |p: &[f64]| Ok(p.iter().enumerate().map(|(k, p)| eigen(k) * p).collect());
        let found =
            conjugate_gradients(&mut product, &<[f64]>::to_vec, &right, (1e-9, 50)).unwrap();
        assert_eq!(found.products, 3);
        for (k, x) in found.solution.iter().enumerate() {
            assert!((x * eigen(k) - right[k]).abs() < 1e-8 * right[k]);
        }
    }

    #[test]
    fn with_the_inverse_as_preconditioner_one_product_is_enough() {
        let eigen = |k: usize| 1.0 + k as f64;
        let mut product = |p: &[f64]| Ok(p.iter().enumerate().map(|(k, p)| eigen(k) * p).collect());
        let inverse = |r: &[f64]| r.iter().enumerate().map(|(k, r)| r / eigen(k)).collect();
        let found = conjugate_gradients(&mut product, &inverse, &[1.0; 40], (1e-10, 50)).unwrap();
        assert_eq!(found.products, 1);
    }
}
