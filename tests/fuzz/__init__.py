"""Mutated files of every kind through the readers, as the command line runs them."""
