"""Decide on a light angle from a sweep: probability, regret and the set of equivalent angles."""
