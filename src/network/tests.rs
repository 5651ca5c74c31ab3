//! Compares every batched form with the plain formula and dual numbers.

use super::*;
use crate::scalar::{Dual, F64x8, WIDTH};
use rand::SeedableRng;

/// The shapes of the hierarchy, and one with all sizes different.
const SHAPES: [(usize, usize, usize); 6] =
    [(3, 5, 1), (4, 5, 1), (6, 5, 3), (1, 10, 1), (120, 5, 3), (2, 7, 4)];

struct Case {
    network: Network,
    parameters: Vec<f64>,
    input: Vec<F64x8>,
    workspace: Workspace,
}

fn cases() -> Vec<Case> {
    let case = |(inputs, height, outputs)| {
        let network = Network::new(inputs, height, outputs).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(9);
        let mut parameters = network.initial(&mut random);
        parameters.iter_mut().for_each(|p| *p += 0.2 * random.random::<f64>());
        let mut lanes = || F64x8::new(std::array::from_fn(|_| 4.0 * random.random::<f64>() - 2.0));
        let input = (0..inputs).map(|_| lanes()).collect();
        Case { network, parameters, input, workspace: Workspace::new(&network) }
    };
    SHAPES.map(case).into()
}

fn one_lane(numbers: &[F64x8], lane: usize) -> Vec<f64> {
    numbers.iter().map(|x| x.to_array()[lane]).collect()
}

fn near(a: f64, b: f64, what: &str) {
    assert!((a - b).abs() <= 1e-13 * (1.0 + b.abs()), "{what}: {a} against {b}");
}

/// `∂out/∂(input, parameters)[index]` of every output, by dual numbers, in one lane.
fn dual(case: &Case, lane: usize, index: usize) -> Vec<f64> {
    let inputs = case.network.inputs();
    let seed = |k: usize, x: f64| Dual { value: x, gradient: [f64::from(u8::from(k == index))] };
    let input = one_lane(&case.input, lane);
    let input: Vec<_> = input.iter().enumerate().map(|(k, &x)| seed(k, x)).collect();
    let parameters = case.parameters.iter().enumerate();
    let parameters: Vec<_> = parameters.map(|(k, &p)| seed(inputs + k, p)).collect();
    case.network.plain(&parameters, &input).iter().map(|y| y.gradient[0]).collect()
}

#[test]
fn a_network_has_as_many_parameters_as_its_layers_hold() {
    let counts = SHAPES.map(|(i, l, o)| Network::new(i, l, o).unwrap().parameter_count());
    assert_eq!(counts, [56, 61, 83, 141, 653, 109]);
    // The counts in Woodward et al. (arXiv:2110.13311) for rot-inv and nn-sum correspond to these
    // inputs.
    assert_eq!(Network::new(5, 5, 1).unwrap().parameter_count(), 66);
    assert_eq!(Network::new(12, 5, 3).unwrap().parameter_count(), 113);
}

#[test]
fn an_empty_layer_is_refused_with_a_reason() {
    for (i, l, o) in [(0, 5, 1), (3, 0, 1), (3, 5, 0)] {
        let error = Network::new(i, l, o).unwrap_err().to_string();
        assert!(error.contains("at least one"), "{error}");
    }
}

#[test]
fn initial_parameters_are_seeded_and_bounded_with_biases_of_zero() {
    let network = Network::new(3, 5, 1).unwrap();
    let start = |seed| network.initial(&mut ChaCha8Rng::seed_from_u64(seed));
    assert_eq!(start(7), start(7));
    assert_ne!(start(7), start(8));
    let parameters = start(7);
    for (layer, bound) in network.layers(&parameters).iter().zip([0.75, 0.6, 1.0_f64]) {
        assert!(layer.weights.iter().all(|w| w.abs() <= bound.sqrt() && w.abs() > 0.0));
        assert!(layer.bias.iter().all(|&b| b.to_bits() == 0));
    }
}

#[test]
fn eight_inputs_at_once_give_the_plain_value() {
    for mut case in cases() {
        let output = case
            .network
            .value::<F64x8>(&case.parameters, &case.input, &mut case.workspace)
            .to_vec();
        assert_eq!(case.workspace.output(), output);
        for lane in 0..WIDTH {
            let plain = case.network.plain(&case.parameters, &one_lane(&case.input, lane));
            for (fast, slow) in one_lane(&output, lane).into_iter().zip(plain) {
                near(fast, slow, "value");
            }
        }
    }
}

#[test]
fn the_pullback_is_the_derivative_by_dual_numbers() {
    for mut case in cases() {
        let (inputs, count) = (case.network.inputs(), case.network.parameter_count());
        case.network.value::<F64x8>(&case.parameters, &case.input, &mut case.workspace);
        let weights = [0.7, -1.3, 0.4, 2.0];
        let cotangent: Vec<_> =
            weights.iter().take(case.network.outputs()).map(|&w| F64x8::of(w)).collect();
        let (mut input, mut parameters) = (vec![F64x8::of(9.0); inputs], vec![F64x8::ZERO; count]);
        let into = Cotangents { input: &mut input, parameters: &mut parameters };
        case.network.pullback::<F64x8>(&case.parameters, &cotangent, &mut case.workspace, into);
        for lane in [0, 5] {
            let fast = [one_lane(&input, lane), one_lane(&parameters, lane)].concat();
            for (index, fast) in fast.into_iter().enumerate() {
                let slow = dual(&case, lane, index);
                let slow = slow.iter().zip(weights).map(|(y, w)| y * w).sum();
                near(fast, slow, "pullback");
            }
        }
    }
}

#[test]
fn jacobian_and_parameter_gradient_are_pullbacks_of_one_output() {
    for mut case in cases() {
        let Case { network, parameters, input, workspace } = &mut case;
        let (inputs, outputs) = (network.inputs(), network.outputs());
        let zeros = vec![F64x8::ZERO; network.parameter_count()];
        network.value::<F64x8>(parameters, input, workspace);
        let mut jacobian = vec![F64x8::ZERO; inputs * outputs];
        network.jacobian::<F64x8>(parameters, workspace, &mut jacobian);
        for output in 0..outputs {
            let mut gradient = vec![F64x8::of(3.0); zeros.len()];
            network.parameter_gradient::<F64x8>(parameters, output, workspace, &mut gradient);
            let mut one = vec![F64x8::ZERO; outputs];
            one[output] = F64x8::of(1.0);
            let (mut by_input, mut by_parameter) = (vec![F64x8::ZERO; inputs], zeros.clone());
            let into = Cotangents { input: &mut by_input, parameters: &mut by_parameter };
            network.pullback::<F64x8>(parameters, &one, workspace, into);
            let fast = [&jacobian[output * inputs..(output + 1) * inputs], &gradient].concat();
            for (fast, slow) in fast.iter().zip([by_input, by_parameter].concat()) {
                (0..WIDTH).for_each(|l| near(fast.to_array()[l], slow.to_array()[l], "one"));
            }
        }
    }
}

#[test]
fn the_tangent_is_the_jacobian_of_one_pair_times_eight_columns() {
    let Case { network, parameters, input, mut workspace } = cases().swap_remove(2);
    let (inputs, outputs, lane) = (network.inputs(), network.outputs(), 6);
    network.value::<F64x8>(&parameters, &input, &mut workspace);
    let mut jacobian = vec![F64x8::ZERO; inputs * outputs];
    network.jacobian::<F64x8>(&parameters, &mut workspace, &mut jacobian);
    let mut output = vec![F64x8::ZERO; outputs];
    network.tangent::<F64x8>(&jacobian, lane, &input, &mut output);
    for column in 0..WIDTH {
        for (o, change) in output.iter().enumerate() {
            let row = one_lane(&jacobian[o * inputs..(o + 1) * inputs], lane);
            let sum = row.iter().zip(one_lane(&input, column)).map(|(a, b)| a * b).sum();
            near(change.to_array()[column], sum, "tangent");
        }
    }
}

#[test]
fn parameter_cotangents_add_up() {
    let Case { network, parameters, input, mut workspace } = cases().swap_remove(0);
    network.value::<F64x8>(&parameters, &input, &mut workspace);
    let mut by_input = [F64x8::ZERO; 3];
    let mut sum = vec![F64x8::ZERO; network.parameter_count()];
    let mut once = sum.clone();
    for k in 0..3 {
        let into = Cotangents { input: &mut by_input, parameters: &mut sum };
        network.pullback::<F64x8>(&parameters, &[F64x8::of(1.0)], &mut workspace, into);
        if k == 0 {
            once.clone_from(&sum);
        }
    }
    for (sum, once) in sum.iter().zip(once) {
        near(sum.sum(), 3.0 * once.sum(), "sum");
    }
}

#[test]
fn huge_weights_saturate_and_stay_finite() {
    for mut case in cases() {
        case.parameters.iter_mut().for_each(|p| *p *= 1e6);
        let Case { network, parameters, input, workspace } = &mut case;
        let finite = |x: &F64x8| x.to_array().iter().all(|x| x.is_finite());
        let bound = 2e6 * (network.height() + 1) as f64;
        let output = network.value::<F64x8>(parameters, input, workspace);
        assert!(output.iter().all(|y| y.to_array().iter().all(|y| y.abs() < bound)));
        let cotangent = vec![F64x8::of(1.0); network.outputs()];
        let mut by_input = vec![F64x8::ZERO; network.inputs()];
        let mut by_parameter = vec![F64x8::ZERO; network.parameter_count()];
        let into = Cotangents { input: &mut by_input, parameters: &mut by_parameter };
        network.pullback::<F64x8>(parameters, &cotangent, workspace, into);
        assert!(by_input.iter().all(finite) && by_parameter.iter().all(finite));
    }
}
