# SPDX-License-Identifier: Apache-2.0
"""The parameter file of a fit."""

from __future__ import annotations

from herding_ros.control.parameters import Sensor
from herding_ros.fit.estimate import Estimate, Fit
from herding_ros.fit.output import parameter_file
from herding_ros.model.crowd import Crowd
from herding_ros.model.potentials import Morse
import numpy as np
import yaml


def test_numbers_of_any_size_are_read_back_as_numbers() -> None:
    """1e-05 without a point is a word in YAML."""
    crowd = Crowd(Morse(1e8, 1e-5, 2e-6, 3.0), noise=1.23456e-7)
    estimate = Estimate('crowd.noise', 'm/s^1.5', crowd.noise, 0.1, 0.1, False)
    found = Fit(crowd, Sensor(1e-5, 2.0), (estimate,), np.eye(1), (), True, 1)
    text = parameter_file(found, 'cohesive', 'a.csv')
    values = yaml.safe_load(text)['/**']['ros__parameters']
    assert values['crowd']['sheep'] == {
        'repulsion': 1e8, 'repulsion_length': 1e-5, 'attraction': 2e-6, 'attraction_length': 3.0,
    }  # fmt: skip
    assert values['crowd']['noise'] == 1.235e-7
    assert values['sensor'] == {'position_noise': 1e-5, 'velocity_noise': 2.0}
    line = next(each for each in text.splitlines() if ' noise: ' in each)
    assert line.endswith('# 1.01e-07 to 1.5e-07')
