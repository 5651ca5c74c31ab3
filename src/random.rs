//! Random numbers: a stream for each use, from one seed.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Independent streams of random numbers from one seed.
#[derive(Clone, Copy, Debug)]
pub enum Stream {
    /// Positions and velocities of the initial state.
    Initial = 0,
    /// The initial guess of a search.
    Guess = 1,
    /// The initial weights of a network.
    Weights = 2,
    /// Phases and directions of a random solenoidal velocity field.
    Field = 3,
    /// Amplitudes of the Ornstein–Uhlenbeck forcing.
    Forcing = 4,
    /// Batches of lessons.
    Lessons = 5,
}

/// A portable random generator: the same numbers on every machine.
pub fn stream(seed: u64, stream: Stream) -> ChaCha8Rng {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    // The stochastic forcing numbers its streams from zero upwards with time; these streams are out
    // of its range.
    generator.set_stream(u64::MAX - stream as u64);
    generator
}
