# SPDX-License-Identifier: Apache-2.0
"""Costs of sheep, dogs and controls: the terms of the objective."""
