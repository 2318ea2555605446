"""Tests of the evaluation of a network's layers, which checks a policy before it is saved."""

import numpy as np

from drake_quad.gym.saving import Layer, evaluate_layers


def test_actions_are_the_outputs_of_the_layers_clipped_to_plus_and_minus_one():
    layers = [Layer(np.array([[0.5, 0.0], [0.0, 0.25]]), np.array([0.0, 0.1]))]
    observations = np.array([[0.4, 0.8], [40.0, -40.0], [-40.0, 40.0]])
    np.testing.assert_allclose(evaluate_layers(layers, observations), [[0.2, 0.3], [1.0, -1.0], [-1.0, 1.0]])


def test_observations_are_shifted_scaled_and_limited_before_the_layers():
    layers = [Layer(0.1 * np.eye(2), np.zeros(2))]
    offset, scale = np.array([1.0, 2.0]), np.array([2.0, 4.0])
    actual = evaluate_layers(layers, np.array([[2.0, 2.5], [3.5, -9.0]]), offset=offset, scale=scale, limit=3.0)
    np.testing.assert_allclose(actual, [[0.2, 0.2], [0.3, -0.3]])
