"""Costs of where the sheep are: the terms of the objective."""
