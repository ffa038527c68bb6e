# SPDX-License-Identifier: Apache-2.0
"""What a node loads before it begins: imported by the server that forks nodes, see forked.py."""

from herding_ros.model.warmup import warm_up
import herding_ros.nodes.controller
import herding_ros.nodes.recorder
import herding_ros.nodes.sim  # noqa: F401

warm_up()
