//! Direct numerical simulation: incompressible Navier–Stokes turbulence in a periodic box, the truth that particles are
//! compared with.
//!
//! `∂u/∂t = P(u × ω) + ν∇²u + f` with `P` the projection on fields without divergence, by Fourier–Galerkin with the 2/3 rule
//! ([`Truncation`]), viscosity by integrating factor, Runge–Kutta of order 2 to 4 ([`Scheme`]), in two
//! and three dimensions, `ρ₀ = 1` (Canuto et al. 2007, doi:10.1007/978-3-540-30728-0). What is resolved converges faster
//! than any power of the number of nodes; the error of time is that of the scheme.
//!
//! ```
//! use whirls::dns::{Settings, Solver, Start};
//! let mut flow = Solver::<3>::new(Settings::new(16, 0.1), &Start::TaylorGreen { velocity: 1.0 })?;
//! flow.advance_to(0.5)?;
//! assert!(flow.statistics().energy < 0.125);
//! # Ok::<(), whirls::Error>(())
//! ```
//!
//! - [`Start`] says what it starts from, [`Forcing`] what keeps it going.
//! - [`Solver::seed`] puts tracers into it, entities that move with the same stages; their velocity is a spline's.
//! - [`SpectralField::filtered`] is the field that a kernel would see.
//! - [`Statistics`] and [`SpectralField::skewness`] are what is known of turbulence.
//!
//! All results have the same bits for any number of threads and on every instruction set, and a step allocates nothing.
//! Cost: `cargo bench --bench dns`.

mod advection;
mod complex;
mod fft;
mod field;
mod forcing;
mod layout;
mod measure;
mod mesh;
mod modes;
mod nodal;
mod pool;
mod rows;
mod runge_kutta;
mod solver;
mod spline;
mod start;
mod statistics;
mod step;

pub use field::{Settings, SpectralField, StepSize};
pub use forcing::Forcing;
pub use layout::{Layout, Truncation};
pub(crate) use measure::{MESHES, mesh_above};
pub use modes::Modes;
pub use runge_kutta::Scheme;
pub use solver::Solver;
pub use spline::Splines;
pub use start::Start;
pub use statistics::Statistics;
