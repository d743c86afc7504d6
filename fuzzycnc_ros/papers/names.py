# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Names of all thermal models that are compared, ours among them; nothing is loaded for them."""

COMPARED = (
    'least_squares',
    'static_ridge',
    'lag_ridge',
    'lag_ridge_speed',
    'lag_ridge_drives',
    'classical_grey',
    'convolution_grey',
    'optimised_grey',
    'discrete_grey',
    'stable_grey',
    'anfis',
    'grey_anfis',
    'arma',
    'static_network',
    'dynamic_network',
    'linear_network',
    'hybrid_network',
    'hybrid_network_speed',
    'gaussian_process',
    'gaussian_process_speed',
    'mlp',
    'mlp_speed',
)
"""In the order of tables."""
