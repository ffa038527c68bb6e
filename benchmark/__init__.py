# SPDX-License-Identifier: Apache-2.0
"""Measures herding_ros against its peers: `scripts/benchmark` runs it and writes the page."""
