//! The cotangents of frames, which a caller gives to an adjoint: the derivatives of a loss of its own.

use super::tape::add_loss;
use super::term::{Stage, Term};
use super::{Needs, Occasion, Phase};

/// Term: adds the cotangents of a frame where the backward sweep comes to it. It has no systems forwards.
#[derive(Clone, Copy, Debug)]
pub struct Cotangents;

impl<const D: usize> Term<D> for Cotangents {
    fn name(&self) -> String {
        "cotangents of frames".to_owned()
    }

    fn stages(&self, occasion: Occasion, needs: &Needs) -> Vec<Stage> {
        match needs.adjoint && occasion.has_judgement() {
            true => vec![Stage::backwards(Phase::Loss, add_loss::<D>)],
            false => Vec::new(),
        }
    }
}
